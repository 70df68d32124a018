"""Sensor pixels that a binned reading averages: their number, and the variance that is lost."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import ShotGeometry


def pixels_per_value(shot: ShotGeometry, scale: Any) -> Any:
    """Return how many sensor pixels of one colour a value of a binned reading averages, (B,), for
    `shot.bin_scale`; of torch or numpy."""
    if shot.scene.develop.resize == "point":  # about one, however many there are
        return shot.xp.ones_like(scale)
    share = 4.0 if shot.scene.is_binned_bayer else 1.0
    if shot.scene.develop.resize == "antialias":
        share = share * (2 / 3) ** 2  # a triangle's mean has 4 / 9 of a box's variance
    return (scale * scale / share).clip(min=1)


def lost_variances(shot: ShotRecord) -> tuple[Tensor, Tensor, Tensor]:
    """Return the variance of sensor pixels that a binned reading has averaged away: of read noise
    and of photon noise at full scale, (B, 1, 1, 1) each, and of the panel's pattern, as a share of
    the squared reading, (B, 3)."""
    away = 1 - 1 / pixels_per_value(shot, shot.bin_scale)
    read, photons = shot.sensor.read_noise.square(), shot.sensor.shot_noise.square()
    if "noise" not in shot.plan:
        read, photons = torch.zeros_like(read), torch.zeros_like(read)
    read, photons = ((away * t)[:, None, None, None] for t in (read, photons))
    pattern = torch.zeros_like(away)[:, None].expand(-1, 3)
    if "saturate" in shot.plan:
        pattern = shot.plan.method.pattern_variance(shot)
    return read, photons, pattern
