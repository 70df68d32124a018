"""The blur of a sensor pixel's view by aperture, point spread and low-pass filter, in space and in
frequency."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.numeric import sinc
from moireaug.shot import ShotRecord

GOLDEN_RATIO = 0.6180339887498949


class Optics(NamedTuple):
    """Widths of aperture, point spread, low-pass filter and motion, (B,) each, in sensor pixels."""

    fill: Tensor
    blur: Tensor
    olpf: Tensor
    motion_x: Tensor
    motion_y: Tensor

    def transfer(self, fu: Tensor, fv: Tensor) -> Tensor:
        """Return the modulation transfer at frequencies in cycles per sensor pixel, which broadcast
        with the fields: of a square aperture, a Gaussian spread, another along the hand's motion,
        and a low-pass filter that doubles the picture along both axes."""
        moved = self.motion_x * fu + self.motion_y * fv
        variance = self.blur.square() * (fu.square() + fv.square()) + moved.square()
        gaussian = torch.exp(-2 * math.pi**2 * variance)
        doubled = torch.cos(math.pi * self.olpf * fu) * torch.cos(math.pi * self.olpf * fv)
        return sinc(self.fill * fu) * sinc(self.fill * fv) * gaussian * doubled

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
        """Return points of equal weight that stand for the whole spread, (B, 2, N) float64, down
        and across in sensor pixels: n * n of them, or n * n for each of n moments of a motion."""
        along = self.quantiles(n * n)
        # no two points share a row or a column, and the golden ratio keeps them even whatever
        # direction an edge cuts them in: two to four times as accurate as a square grid
        order = sorted(range(n * n), key=lambda i: i * GOLDEN_RATIO % 1)
        points = torch.stack([along, along[:, order]], 1)
        if not (self.motion_x.any() or self.motion_y.any()):
            return points
        rank = torch.arange(n, dtype=torch.float64, device=self.fill.device)
        moments = torch.special.ndtri((rank + 0.5) / n)
        moments = moments / moments.square().mean().sqrt().clamp(min=1e-9)
        motion = torch.stack([self.motion_y, self.motion_x], 1)[..., None] * moments
        return (points[..., None] + motion[:, :, None]).flatten(2)


def optics_of(shot: ShotRecord) -> Optics:
    """Return a shot's drawn fields that blur."""
    lens = shot.lens
    return Optics(shot.sensor.fill, lens.blur, lens.olpf, lens.motion_x, lens.motion_y)
