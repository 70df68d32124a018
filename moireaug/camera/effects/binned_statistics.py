"""Sensor pixels that a binned reading averages: their number, the variance that is lost, and their
mean when clipped."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.scene.shot import ShotRecord

MIN_VARIANCE = 1e-10  # of readings that count as different


def pixels_per_value(shot: ShotRecord, scale: Tensor) -> Tensor:
    """Return how many sensor pixels of one colour a value of a binned reading averages, (B,), for
    `shot.bin_scale`."""
    if shot.scene.develop.resize == "point":  # about one, however many there are
        return torch.ones_like(scale)
    share = 4.0 if shot.scene.is_binned_bayer else 1.0
    if shot.scene.develop.resize == "antialias":
        share = share * (2 / 3) ** 2  # a triangle's mean has 4 / 9 of a box's variance
    return (scale.square() / share).clamp(min=1)


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


def expected_clip(raw: Tensor, noise: Tensor, pattern: Tensor) -> Tensor:
    """Return the mean of readings clipped to [0, 1], by their mean and the variances of noise and
    of the panel's pattern, both taken as normally distributed. A pattern is light, and never below
    0: noise alone is clipped there."""
    above = _mean_excess(raw - 1, noise + pattern)
    above = torch.minimum(above, _greatest_excess(raw, noise, pattern))
    return raw + _mean_excess(-raw, noise) - above


def _greatest_excess(raw: Tensor, noise: Tensor, pattern: Tensor) -> Tensor:
    """Return a bound on the mean of max(x - 1, 0) of light x of mean `raw` and variance `pattern`,
    which is nowhere below 0, with noise. No light of that mean and variance, however sparse, has a
    smaller mean when clipped than one of two levels, one of which is 0 (Scarf, 1958)."""
    light = raw.clamp(min=MIN_VARIANCE)
    clipped = torch.minimum(light / 2, light.square() / (light.square() + pattern))
    some = noise > MIN_VARIANCE  # the root has no slope at 0
    sigma = torch.where(some, torch.where(some, noise, 1.0).sqrt(), 0.0)
    return light - clipped + sigma / (2 * torch.pi) ** 0.5


def _mean_excess(mean: Tensor, variance: Tensor) -> Tensor:
    """Return the mean of max(x, 0) of normally distributed x."""
    some = variance > MIN_VARIANCE
    sigma = torch.where(some, variance, 1.0).sqrt()
    z = mean / sigma
    excess = mean * torch.special.ndtr(z) + sigma * torch.exp(-z * z / 2) / (2 * torch.pi) ** 0.5
    return torch.where(some, excess, torch.where(mean > 0, mean, torch.zeros_like(mean)))
