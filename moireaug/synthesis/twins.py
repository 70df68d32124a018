"""The twin of a photo: the same shot without moiré."""

from __future__ import annotations

import dataclasses
import functools

from moireaug.scenes import Scene, Shot
from moireaug.shot_checks import check_is_shot


def without_moire(shot: Shot) -> Shot:
    """Return the same shot of a panel without subpixels: camera, light and noise stay, and the
    stripes give way to their mean light.

    `capture(images, without_moire(shot))` is a photo that no camera can take, and the target that
    teaches a demoiréing network to remove the moiré alone.

    Raises:
        TypeError: anything but a shot.
    """
    check_is_shot(shot)
    return dataclasses.replace(shot, scene=_without_subpixels(shot.scene))


@functools.lru_cache(maxsize=64)  # a new scene would be planned again for every shot
def _without_subpixels(scene: Scene) -> Scene:
    """Return the scene with the exposure that sees a panel's mean light."""
    return dataclasses.replace(scene, sensor=dataclasses.replace(scene.sensor, exposure="mean"))
