"""The raw reading of a pair as a file, and what a raw developer needs to know of it."""

import io
from typing import Any

import numpy as np
import torch

from moireaug import Shot, expose
from moireaug.camera.effects.tone import colour_matrix
from moireaug.synthesis import Pair

WHITE_LEVEL = 65535  # of a reading as it is written, in uint16
PLANES = {3: ["R", "G", "B"], 4: ["R", "G", "G", "B"]}


@torch.no_grad()
def reading_of(pair: Pair) -> np.ndarray:
    """Return the raw reading of a pair's photo, (planes, h, w) uint16 up to WHITE_LEVEL."""
    raw = expose(pair.original[None].float() / 255, pair.shot)[0]
    return (raw * WHITE_LEVEL).round().numpy().astype(np.uint16)


def npy_of(reading: np.ndarray) -> bytes:
    """Return a reading as the content of a .npy file."""
    file = io.BytesIO()
    np.save(file, reading)
    return file.getvalue()


def raw_metadata(shot: Shot, reading: np.ndarray) -> dict[str, Any]:
    """Return what is known of the reading of a shot of one image, as plain values.

    Returns:
        planes: colours of the planes, in their order in the file: those of an RGGB cell.
        binned: whether a value is the mean of all sensor pixels of its colour in a photo pixel; if
            not, of one sensor pixel, and plane k lies at row k // 2 and column k % 2 of each cell.
        black_level, white_level: values of no light and of saturation.
        white_balance: factors on red, green and blue.
        colour_matrix: 3 x 3, from white-balanced sensor colours to those of sRGB.
        linear: whether values are linear in light; if not, in sRGB codes.
        exposure_time: of a row in seconds; None where the scene does not say.
        sensor_pixels: per photo pixel, along each axis.
        gain, read_noise, shot_noise: as in `Sensor`.
    """
    develop, sensor, scene = shot.develop, shot.sensor, shot.scene
    matrix = colour_matrix(sensor.crosstalk, develop.saturation)[0]
    shutter = sensor.shutter.item()
    return {
        "planes": PLANES[len(reading)],
        "binned": scene.is_binned,
        "black_level": 0,
        "white_level": WHITE_LEVEL,
        "white_balance": [develop.red.item(), 1.0, develop.blue.item()],
        "colour_matrix": matrix.tolist(),
        "linear": scene.develop.linear_light,
        "exposure_time": shutter or None,
        "sensor_pixels": shot.sensor_scale.item(),
        "gain": sensor.gain.item(),
        "read_noise": sensor.read_noise.item(),
        "shot_noise": sensor.shot_noise.item(),
    }
