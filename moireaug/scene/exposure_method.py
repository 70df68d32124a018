"""The base class of every exposure method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor


class ExposureMethod(ABC):
    """Integrates panel light over the aperture and the point spread of each sensor pixel that a
    photo reads.

    `name` is its name in `Sensor.exposure`, `reason` its reason in the plan. `harmonics` are the
    (k, l) pairs that it sums, if any, and `taps` the panel pixels along each axis whose light it
    adds up for one sensor pixel. `sums_harmonics` says whether it shows a pattern by harmonics
    alone, `has_aperture` whether it integrates at all, and `differentiable_in_shot` whether its
    readings have a gradient in the shot's fields."""

    name: str
    reason: str
    harmonics: tuple[tuple[int, int], ...] = ()
    taps: int = 1
    sums_harmonics = False
    has_aperture = True
    differentiable_in_shot = False

    @abstractmethod
    def __call__(self, light: Tensor, shot: Any) -> Tensor:
        """Return the readings (B, 4 or 3, h, w) of the panel light (B, 3, H, W)."""

    def lost_variance(self, points: Tensor, shot: Any) -> Tensor:
        """Return the variance of the spread that it does not integrate, at image points (1, h, w,
        2), in squared image pixels: (B, h, w). The picture is blurred by as much before."""
        return points.new_zeros(len(shot), *points.shape[1:3])

    def max_lost_variance(self, scene: Any) -> float:
        """Return the most that `lost_variance` is in any view of a scene."""
        return 0.0

    def seen_variance(self, shot: Any) -> Tensor | None:
        """Return the variance of the moiré in the middle of the image, as a share of the squared
        reading, by colour filter: (B, 3); None where it has no closed form."""
        return None

    def pattern_variance(self, shot: Any) -> Tensor:
        """Return the variance of the panel's pattern that is averaged away in the middle, as a
        share of the squared mean light, by colour filter: (B, 3)."""
        return torch.zeros(len(shot), 3, dtype=torch.float64, device=shot.device)
