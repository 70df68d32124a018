"""The twin of a photo: the same shot without moiré."""

from __future__ import annotations

import dataclasses
import functools
from typing import TypeVar

from torch import Tensor

from moireaug.scene.by_name import with_values
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scene.shot_checks import check_is_shot
from moireaug.scenes import Scene, Shot

SEEN_CODES = 2.0  # of moiré, RMS: less is hard to see in a photo
QUIET = {"sensor.read_noise": 0.0, "sensor.shot_noise": 0.0}  # a sensor without noise

AnyShot = TypeVar("AnyShot", bound=Shot | MixedShot[Shot])


def without_moire(shot: AnyShot, *, noise: bool = True) -> AnyShot:
    """Return the same shot of a panel without subpixels: camera and light stay, and the stripes
    give way to their mean light. `capture(images, without_moire(shot))` teaches a demoiréing
    network to remove the moiré alone.

    Args:
        shot: shot of a photo, or the draw of a mixture.
        noise: whether the sensor's noise and JPEG's errors stay, too.

    Raises:
        TypeError: anything but a shot.
    """
    if isinstance(shot, MixedShot):
        scenes = tuple(without_subpixels(scene, noise) for scene in shot.scenes)
        return dataclasses.replace(shot, scenes=scenes)
    check_is_shot(shot)
    return dataclasses.replace(shot, scene=without_subpixels(shot.scene, noise))


def moire_codes(photos: Tensor, twins: Tensor) -> Tensor:
    """Return the strength of moiré in photos (B, 3, H, W) in [0, 1], (B,) float64: the root mean
    square of their differences from their twins, of `without_moire(shot)`, in codes of 255."""
    return 255 * (photos.double() - twins.double()).square().mean((1, 2, 3)).sqrt()


@functools.lru_cache(maxsize=64)  # a new scene would be planned again for every shot
def without_subpixels(scene: Scene, noise: bool = True) -> Scene:
    """Return the scene with the exposure that sees a panel's mean light: its photos are twins."""
    scene = with_values(scene, {"sensor.exposure": "mean"})
    if noise:
        return scene
    return with_values(scene, QUIET | {"develop.jpeg": 0.0})
