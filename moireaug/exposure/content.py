"""How much of each panel pixel around it a sensor pixel sees.

Aperture and point spread, projected on an axis of the panel, are a box and a Gaussian around it; a subpixel is a box,
too. Their convolution is the share of light from each panel pixel, in closed form. Both axes apart are exact where the
view is upright and for the second moments of any view, which is what a picture's detail asks for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.exposure.optics import Optics

TAIL = 1.0  # standard deviations of the spread that taps must reach
LEAST = 1e-9  # share of the nearest panel pixel where none is seen, so that shares can be normalised
SHARP = 1e-12  # least variance of a spread, in squared cells


class Footprint(NamedTuple):
    """What a sensor pixel sees along one axis of the panel, in cells: a box and a Gaussian around it."""

    box: Tensor
    variance: Tensor

    def reach(self) -> Tensor:
        """Return how far to each side it sees."""
        return self.box / 2 + TAIL * self.variance.sqrt()


def footprint(step: Tensor, optics: Optics) -> Footprint:
    """Return the footprint along one axis.

    The box is the longer side of the aperture's shadow; the shorter one, lens and low-pass filter are in the Gaussian.

    Args:
        step: (B, ..., 2), cells of the panel along this axis by sensor pixels along u and v.
        optics: (B,) fields.
    """
    fill, blur, olpf = (t.reshape(-1, *[1] * (step.ndim - 2)).to(step.dtype) for t in optics)
    long, short = step.abs().amax(-1), step.abs().amin(-1)
    spread = blur.square() + olpf.square() / 4
    variance = (short * fill).square() / 12 + step.square().sum(-1) * spread
    return Footprint(long * fill, variance + SHARP)


def fitted(seen: Footprint, width: float | Tensor, taps: int) -> tuple[Footprint, Tensor]:
    """Return the footprint narrowed to what `taps` panel pixels hold, and the variance that it lost, in squared cells.

    The prefilter blurs the picture by as much.
    """
    room = taps / 2 - width / 2
    shrink = (room / seen.reach()).clamp(max=1)
    kept = Footprint(seen.box * shrink, seen.variance * shrink.square())
    lost = (seen.box.square() / 12 + seen.variance) * (1 - shrink.square())
    return kept, lost


def shares(offset: Tensor, seen: Footprint, width: Tensor, taps: int) -> Tensor:
    """Return the share of a sensor pixel's view that falls on each of `taps` subpixels: (B, h, w, taps).

    Args:
        offset: (B, h, w), position from the nearest subpixel's centre, in cells: -1/2 to 1/2.
        seen: the footprint along this axis, (B, h, w) each.
        width: of the subpixel along this axis in cells, broadcastable to (B, h, w).
    """
    k = torch.arange(taps, dtype=offset.dtype, device=offset.device) - taps // 2
    at = offset[..., None] - k
    box, sigma, width = seen.box[..., None], seen.variance.sqrt()[..., None], width[..., None]
    outer, inner = (box + width) / 2, (box - width) / 2
    total = 0.0
    for sign, edge in ((1, outer), (-1, inner), (-1, -inner), (1, -outer)):
        total = total + sign * _normal_integral((at + edge) / sigma)
    return total * (sigma / box)


def normalised(share: Tensor) -> Tensor:
    """Return shares that sum to 1; where nothing is seen, all of it is the nearest subpixel's."""
    nearest = torch.zeros_like(share[..., :1])
    least = torch.nn.functional.pad(nearest + LEAST, (share.shape[-1] // 2,) * 2)
    share = share.clamp(min=0) + least  # rounding may leave a share a digit below zero
    return share / share.sum(-1, keepdim=True)


def _normal_integral(z: Tensor) -> Tensor:
    """The integral of the normal distribution function up to z."""
    return z * torch.special.ndtr(z) + torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)
