"""The blur of a sensor pixel's view by aperture, point spread and low-pass filter, in space and in
frequency."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.common.tensor_physics import optics
from moireaug.scene.shot_geometry import ShotGeometry

GOLDEN_RATIO = 0.6180339887498949
PLASTIC_NUMBER = 1.324717957244746


class Optics(NamedTuple):
    """Widths of aperture, point spread, low-pass filter and motion, (B,) each, in sensor pixels;
    tensors or arrays."""

    fill: Any
    blur: Any
    olpf: Any
    motion_x: Any
    motion_y: Any

    def transfer(self, fu: Tensor, fv: Tensor) -> Tensor:
        """Return the modulation transfer at frequencies in cycles per sensor pixel, which broadcast
        with the fields."""
        return optics.transfer(fu, fv, self)

    def quantiles(self, n: int) -> Tensor:
        """Return the n mid-quantiles of the light along one axis, without motion, in sensor pixels:
        (B, n) float64.

        Equal weights at these points integrate any smooth light; without blur they are an even
        lattice.
        """
        target = ((torch.arange(n, dtype=torch.float64, device=self.fill.device) + 0.5) / n).expand(
            len(self.fill), n
        )
        half, olpf = self.fill[:, None] / 2, self.olpf[:, None] / 2
        sigma = self.blur[:, None].clamp(min=1e-6)

        def integral(z: Tensor) -> Tensor:  # of the normal distribution function
            return z * torch.special.ndtr(z) + torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)

        def below(x: Tensor) -> Tensor:
            within = integral((x + half) / sigma) - integral((x - half) / sigma)
            return within * sigma / (2 * half)

        high = (half + olpf + 9 * sigma).expand_as(target)
        low = -high
        for _ in range(60):
            mid = (low + high) / 2
            under = (below(mid - olpf) + below(mid + olpf)) / 2 < target
            low, high = torch.where(under, mid, low), torch.where(under, high, mid)
        return (low + high) / 2

    def offsets(self, n: int) -> Tensor:
        """Return n * n points of equal weight that stand for the whole spread, (B, 2, n * n)
        float64, down and across in sensor pixels; with motion, each has a moment of it, too."""
        along = self.quantiles(n * n)
        moves = bool(self.motion_x.any() or self.motion_y.any())
        # No two points share a row, a column or a moment, and multiples of the golden ratio keep
        # them even whatever direction an edge cuts them in: two to four times as accurate as a
        # square grid. In three dimensions, powers of the plastic number do (Roberts, 2018).
        ratio = 1 / PLASTIC_NUMBER if moves else GOLDEN_RATIO
        points = torch.stack([along, along[:, _even_order(n * n, ratio)]], 1)
        if not moves:
            return points
        rank = torch.arange(n * n, dtype=torch.float64, device=self.fill.device)
        moments = torch.special.ndtri((rank + 0.5) / n**2)
        moments = moments / moments.square().mean().sqrt().clamp(min=1e-9)
        moments = moments[_even_order(n * n, 1 / PLASTIC_NUMBER**2)]
        return points + torch.stack([self.motion_y, self.motion_x], 1)[..., None] * moments


def _even_order(n: int, ratio: float) -> list[int]:
    """Return the order of n whole numbers by the fractions of their multiples of a ratio."""
    return sorted(range(n), key=lambda i: i * ratio % 1)


def optics_of(shot: ShotGeometry) -> Optics:
    """Return a shot's drawn fields that blur."""
    lens = shot.lens
    return Optics(shot.sensor.fill, lens.blur, lens.olpf, lens.motion_x, lens.motion_y)
