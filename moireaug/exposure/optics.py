"""What blurs a sensor pixel's view: aperture, point spread and low-pass filter, in space and in
frequency."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.numeric import sinc


class Optics(NamedTuple):
    """What blurs a sensor pixel's view: (B,) each, in sensor pixels."""

    fill: Tensor
    blur: Tensor
    olpf: Tensor

    def variance(self) -> Tensor:
        """Return the variance of the point spread along one axis, in squared sensor pixels."""
        return self.fill.square() / 12 + self.blur.square() + self.olpf.square() / 4

    def transfer(self, fu: Tensor, fv: Tensor) -> Tensor:
        """Return the modulation transfer at cycles per sensor pixel (B, ...): a square aperture, a
        Gaussian spread, and a low-pass filter that doubles the picture along both axes."""
        fill, blur, olpf = (t.reshape(-1, *[1] * (fu.ndim - 1)) for t in self)
        spread = torch.exp(-2 * math.pi**2 * blur.square() * (fu.square() + fv.square()))
        doubled = torch.cos(math.pi * olpf * fu) * torch.cos(math.pi * olpf * fv)
        return sinc(fill * fu) * sinc(fill * fv) * spread * doubled

    def quantiles(self, n: int) -> Tensor:
        """Return the n mid-quantiles of the light along one axis, in sensor pixels: (B, n) float64.

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


def optics_of(shot) -> Optics:
    """Return the drawn fields that blur."""
    return Optics(shot.sensor.fill, shot.lens.blur, shot.lens.olpf)
