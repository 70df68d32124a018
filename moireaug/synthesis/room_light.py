"""The light of a screen and of the room around it, before a sensor's noise and saturation, and the
reading of both together."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from moireaug.camera.effects.sensor import Noise, mean_of_clipped
from moireaug.camera.exposure.extremes import max_glare, modulation_depth
from moireaug.capture import expose
from moireaug.common.numeric import per_image
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from moireaug.scenes import Scene, Shot
from moireaug.synthesis.twins import QUIET

# what the room is seen by: the same camera, straight on, without a panel's pattern and glass
FRONTAL = {"view.yaw": 0.0, "view.pitch": 0.0, "view.roll": 0.0, "view.zoom": 1.0}
FRONTAL |= {"view.shift_x": 0.0, "view.shift_y": 0.0, "lens.k1": 0.0, "lens.k2": 0.0}
FRONTAL |= {"panel.black": 0.0, "panel.glare": 0.0}


def light_of_screen(codes: Tensor, shot: Shot) -> Tensor:
    """Return the light of a screen's plane (B, 3, H, W), of the shape of a binned reading and at
    the shot's gain: without noise, and above 1 where the reading would saturate."""
    return _light(codes, shot, _quiet_scene(shot.scene), QUIET)


def light_of_room(codes: Tensor, shot: Shot) -> Tensor:
    """Return the light of a room (B, 3, H, W), seen straight on and without a pattern; as of
    `light_of_screen`."""
    return _light(codes, shot, _quiet_room_scene(shot.scene), QUIET | FRONTAL)


def read(light: Tensor, shot: Shot, inside: Tensor) -> Tensor:
    """Return a shot's binned reading of light: with noise, and clipped as by `ClipReading`; inside:
    (B, 1, H, W) share of each pixel that the screen takes, whose pattern saturates."""
    shot = shot.to(light.device)
    if "noise" in shot.plan.exposing:
        light = Noise()(light, shot)
    if "clip_reading" not in shot.plan.exposing:
        return light
    return mean_of_clipped(light, shot, inside)


def _light(codes: Tensor, shot: Shot, scene: Scene, fixed: Mapping[str, float]) -> Tensor:
    """Return the light that a quiet scene sees by a shot, but for its fixed values."""
    gain = bounds(scene.sensor.gain)[0]
    numbers = shot.numbers()
    for name, value in {**fixed, "sensor.gain": gain}.items():
        numbers[name] = torch.full_like(numbers[name], value)
    reading = expose(codes, scene.shot_from_numbers(shot.size, numbers, shot.seed))
    return reading * per_image(shot.sensor.gain.to(reading.device) / gain, reading)


@functools.lru_cache(maxsize=64)  # a new scene would be planned again for every shot
def _quiet_scene(scene: Scene) -> Scene:
    """Return a scene without noise, of a gain with which nothing saturates; its tolerance is as
    much smaller."""
    gain = 1 / (1 + modulation_depth(scene) + max_glare(scene))
    tolerance = min(1.0, scene.tolerance * gain / bounds(scene.sensor.gain)[1])
    return replace(with_values(scene, QUIET | {"sensor.gain": gain}), tolerance=tolerance)


@functools.lru_cache(maxsize=64)
def _quiet_room_scene(scene: Scene) -> Scene:
    return with_values(_quiet_scene(scene), FRONTAL | {"sensor.exposure": "mean"})
