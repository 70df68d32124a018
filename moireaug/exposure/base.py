"""The base class of every exposure method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from torch import Tensor


class ExposureMethod(ABC):
    """Integrates panel light over the aperture and the point spread of each sensor pixel that a
    photo reads.

    `name` is its name in `Sensor.exposure`, `reason` its reason in the plan. `harmonics` are the
    (k, l) pairs that it sums, if any, and `taps` the panel pixels along each axis whose light it
    adds up for one sensor pixel. `differentiable_in_shot` says whether the readings have a gradient
    in the shot's fields.
    """

    name: str
    reason: str
    harmonics: tuple[tuple[int, int], ...] = ()
    taps: int = 1
    differentiable_in_shot = False

    @abstractmethod
    def __call__(self, light: Tensor, shot: Any) -> Tensor:
        """Return the readings (B, 4 or 3, h, w) of the panel light (B, 3, H, W)."""
