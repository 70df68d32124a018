"""White balance, colour matrix, tone curve and brightness."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, format_range, left_out, verdict_of
from moireaug.camera.exposure.filters import crosstalk_matrix
from moireaug.common.numeric import clip, library_of, mix_colours, per_image
from moireaug.common.tensor_physics import tone
from moireaug.scene.fields import deviation, varies
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

CONTRAST_PER_CODE = 6 * 3**0.5  # the reciprocal of the most by which a contrast of 1 moves a code


class Balance(Effect):
    """Multiplies red and blue by a gain each."""

    name = "balance"
    mixes_readings = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        red, blue = scene.develop.red, scene.develop.blue
        why = f"red times {format_range(red)}, blue {format_range(blue)}"
        change = max(deviation(red, 1), deviation(blue, 1))
        return verdict_of(change, scene, why, "red and blue as they are read")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        return balance(photo, shot.develop.red, shot.develop.blue)


class ColourMatrix(Effect):
    """Undoes the filters' crosstalk and sets the saturation."""

    name = "colour_matrix"
    mixes_readings = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        crosstalk, saturation = scene.sensor.crosstalk, scene.develop.saturation
        if not varies(crosstalk) and not varies(saturation, 1.0):
            return left_out("the sensor's own colours")
        return called(
            f"crosstalk of {format_range(crosstalk)} undone, saturation {format_range(saturation)}"
        )

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        matrix = colour_matrix(shot.sensor.crosstalk, shot.develop.saturation)
        return mix_colours(matrix, photo)


class ToneCurve(Effect):
    """Rolls off highlights, then adds contrast, on codes."""

    name = "tone_curve"

    def verdict(self, scene: SceneRecord) -> Verdict:
        contrast, shoulder = scene.develop.contrast, scene.develop.shoulder
        most = deviation(contrast, 0) / CONTRAST_PER_CODE + shoulder_shift(deviation(shoulder, 0))
        why = f"shoulder {format_range(shoulder)}, contrast {format_range(contrast)}"
        return verdict_of(most, scene, why, "a straight line")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        return tone_curve(photo, shot.develop.contrast, shot.develop.shoulder)


class Brighten(Effect):
    """Adds a number to the codes."""

    name = "brighten"
    mixes_readings = True

    def verdict(self, scene: SceneRecord) -> Verdict:
        brighten = scene.develop.brighten
        why = f"{format_range(brighten)} added"
        return verdict_of(deviation(brighten, 0), scene, why, "nothing to add")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        return photo + per_image(shot.develop.brighten, photo)


def colour_matrix(crosstalk: Any, saturation: Any) -> Any:
    """Return the matrix (B, 3, 3) from the filters' colours to the photo's: the crosstalk's
    inverse, then each colour's difference from the mean of the three times the saturation. Both
    arguments are (B,), of torch or numpy. Rows sum to 1."""
    xp, mean = library_of(saturation), 1 / 3
    one = crosstalk_matrix(xp.zeros_like(saturation))
    vivid = mean + saturation[:, None, None] * (one - mean)
    return vivid @ xp.linalg.inv(crosstalk_matrix(crosstalk))


def tone_curve(photo: Tensor, contrast: Tensor, shoulder: Tensor) -> Tensor:
    """Return y + contrast (2 y - 1) y (1 - y) with y = (1 + shoulder) x / (1 + shoulder x) of
    codes x, contrast (B,) in [-1, 1] and shoulder (B,) >= 0. It never falls, and keeps 0 and 1.
    Codes are clipped to [0, 1] first."""
    x = clip(photo)
    y = tone.shoulder_curve(x, per_image(shoulder, photo))
    return tone.contrast_curve(y, per_image(contrast, photo))


def shoulder_shift(shoulder: float) -> float:
    """Return the most by which a shoulder moves a code: at x = 1 / (1 + sqrt(1 + shoulder))."""
    return shoulder / (1 + math.sqrt(1 + shoulder)) ** 2


def balance(photo: Tensor, red: Tensor, blue: Tensor) -> Tensor:
    """Return (B, 3, H, W) with red and blue times a gain (B,) each."""
    gains = torch.stack([red, torch.ones_like(red), blue], -1).to(photo.dtype)
    return photo * gains[:, :, None, None]
