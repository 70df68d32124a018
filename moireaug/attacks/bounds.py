"""Bounds on the noise of a reading: by how much its sRGB codes may change, or its light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.camera.effects.srgb import codes_of_light, light_of_codes
from moireaug.scenes import Scene

BOUNDS = ("codes", "light")  # what eps counts
# units in the last place by which a box is narrower than its bound, so that no rounding leaves it
ROUNDING_ULPS = 8
MIN_SLOPE = 1e-12  # where rounding would leave a box no width
INVERSE_SHRINKAGE = 1 - 1e-6  # of a noise that is taken back to the variable of a search


class Box(NamedTuple):
    """The noise that a bound allows on each value of a reading.

    A search moves a variable in [-eps, eps]. From 0, its noise grows in a straight line to either
    end of its box, and goes on along that line where the variable exceeds eps.

    Args:
        slopes: noise per unit of the variable above 0 and below 0, (B, ...) each, above 0; None
            where the variable is the noise itself.
    """

    slopes: tuple[Tensor, Tensor] | None = None

    def noise(self, variable: Tensor) -> Tensor:
        """Return the noise (B, ...) of a variable (B, ...). Differentiable in both."""
        if self.slopes is None:
            return variable
        return variable * torch.where(variable > 0, *self.slopes)

    def variable(self, noise: Tensor) -> Tensor:
        """Return the variable (B, ...) of a noise (B, ...): the inverse, but nearer to 0 by less
        than rounding matters, so that a noise at a bound stays within it."""
        if self.slopes is None:
            return noise
        return noise / torch.where(noise > 0, *self.slopes) * INVERSE_SHRINKAGE


@dataclass(frozen=True)
class Bound:
    """A bound on each value of a reading.

    Args:
        eps: size, in [0, 1] units.
        unit: what eps counts, one of `BOUNDS`.
        is_light: whether the reading is light, whose codes the sRGB curve gives; without, it is
            codes already, and both units are the same.
    """

    eps: float
    unit: str = "codes"
    is_light: bool = False

    def box(self, reading: Tensor) -> Box:
        """Return the box around a clean reading (B, ...). Differentiable in the reading.

        In codes, a value may go from decode(encode(value) - eps) to decode(encode(value) + eps),
        where decode is the sRGB curve, straight below 0 and continued above 1. A box has an end
        below 0 or above 1, too: a reading that can be seen there (see `camera.CameraProblem`) may
        go on to it.
        """
        if self.unit == "light" or not self.is_light or not self.eps:
            return Box()
        codes = codes_of_light(reading)
        return Box((self._slope(reading, codes, self.eps), self._slope(reading, codes, -self.eps)))

    def _slope(self, reading: Tensor, codes: Tensor, change: float) -> Tensor:
        """Return the noise per unit of the variable toward the end of a box."""
        end = light_of_codes(codes + change)
        size = reading.abs() + end.abs()
        rounding = ROUNDING_ULPS * torch.finfo(reading.dtype).eps * size
        return (((end - reading).abs() - rounding) / self.eps).clamp(min=MIN_SLOPE)


def bound_on_reading(eps: float, unit: str, scene: Scene) -> Bound:
    """Return the bound on the raw readings of a scene."""
    return Bound(eps, unit, scene.develop.linear_light)
