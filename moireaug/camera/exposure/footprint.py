"""The share of a sensor pixel's view that falls on each panel pixel around it.

Aperture and point spread, projected on an axis of the panel, are a box and a Gaussian around it; a
subpixel is a box, too. Their convolution is the share of light from each panel pixel, in closed
form. Taking each axis alone is exact for an upright view, and for the second moments of any view,
which are all that a picture's detail needs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.camera.exposure.optics import Optics
from moireaug.common.physics.footprint import MIN_BLUR_VARIANCE
from moireaug.common.tensor_physics import footprint

# share of the nearest panel pixel where none is seen, so that shares can be normalised
NEAREST_GUARD_SHARE = 1e-9
MIN_EXPONENT = -80.0  # not far below, float32 numbers are denormal and many times slower
# squared cells: its product with a shrinking may be 0 in float32, whose power of -3/2 is infinite
MIN_NARROWED_VARIANCE = 1e-20
# standard deviations of the spread: of a much narrower box, float32 holds no difference of its ends
MIN_BOX_SIGMAS = 1e-3


class Footprint(NamedTuple):
    """The view of a sensor pixel along one axis of the panel: a box convolved with a Gaussian.

    Args:
        box: width of the box, in cells.
        variance: variance of the Gaussian, in squared cells.
    """

    box: Tensor
    variance: Tensor

    @staticmethod
    def of(step: Tensor, optics: Optics) -> Footprint:
        """Return the footprint along one axis.

        The box is the longer side of the aperture's shadow; the shorter one, lens, motion and
        low-pass filter are in the Gaussian.

        Args:
            step: (B, ..., 2), cells of the panel along this axis by sensor pixels along u and v.
            optics: (B,) fields.
        """
        fill = _over(optics.fill, step)
        u, v = step.abs().unbind(-1)
        long, short = torch.maximum(u, v), torch.minimum(u, v)
        variance = footprint.side_variance(short * fill) + blur_variance(step, optics)
        return Footprint(long * fill, variance + MIN_BLUR_VARIANCE)

    def reach(self) -> Tensor:
        """Return how far to each side it sees, in cells."""
        return footprint.reach(self.box, self.variance.sqrt())

    def fitted(self, width: float | Tensor, taps: int) -> tuple[Footprint, Tensor]:
        """Return it narrowed to the reach of `taps` panel pixels, and the variance that it lost,
        in squared cells, by which the prefilter blurs the picture; (B, ...) each.

        Args:
            width: of the subpixel along this axis in cells, broadcastable to (B, ...).
        """
        shrink = footprint.narrowing(self.box, self.variance.sqrt(), width, taps / 2)
        variance = (self.variance * shrink.square()).clamp(min=MIN_NARROWED_VARIANCE)
        lost = (self.box.square() / 12 + self.variance) * (1 - shrink.square())
        return Footprint(self.box * shrink, variance), lost


def blur_variance(step: Tensor, optics: Optics) -> Tensor:
    """Return the variance along one axis that lens, motion and low-pass filter add, in squared
    cells; arguments as in `Footprint.of`."""
    drawn = (optics.blur, optics.olpf, optics.motion_x, optics.motion_y)
    blur, olpf, motion_x, motion_y = (_over(t, step) for t in drawn)
    u, v = step.unbind(-1)
    moved = footprint.motion_sigma(u, v, motion_x, motion_y)
    return footprint.lens_variance(u, v, blur, olpf) + moved.square()


def _over(drawn: Tensor, step: Tensor) -> Tensor:
    """Return a drawn number (B,) that broadcasts over steps (B, ..., 2)."""
    return drawn.reshape(-1, *[1] * (step.ndim - 2)).to(step.dtype)


def tap_weights(offset: Tensor, footprint: Footprint, width: Tensor, taps: int) -> Tensor:
    """Return the share of a sensor pixel's view that falls on each of `taps` subpixels:
    (taps, B, h, w).

    Args:
        offset: (B, h, w), position from the nearest subpixel's centre, in cells: -1/2 to 1/2.
        footprint: along this axis, (B, h, w) each.
        width: of the subpixel along this axis in cells, broadcastable to (B, h, w).
    """
    sharpness = (2 * footprint.variance).rsqrt()
    half = (footprint.box / 2 * sharpness).clamp(min=MIN_BOX_SIGMAS / 8**0.5)
    at = offset * sharpness
    left, right = at - half, at + half  # ends of the box

    def beyond(edge: Tensor) -> Tensor:
        """Return the share of the view past an edge, before the factor `unit` and up to a
        constant."""
        edge = edge * sharpness
        return _erf_integral(right - edge) - _erf_integral(left - edge)

    centres = around(taps, offset)
    unit = 1 / (4 * math.sqrt(math.pi) * half)
    return (beyond(centres - width / 2) - beyond(centres + width / 2)) * unit


def around(taps: int, like: Tensor) -> Tensor:
    """Return the whole cells from the nearest subpixel to each of `taps` around it, along a new
    first axis: (taps, 1, ..., 1)."""
    cells = torch.arange(taps, dtype=like.dtype, device=like.device) - taps // 2
    return cells.reshape(-1, *[1] * like.ndim)


def normalised(share: Tensor) -> Tensor:
    """Return shares (taps, ...) that sum to 1; where nothing is seen, all of it is the nearest
    subpixel's."""
    share = share.clamp(min=0)  # rounding may leave a share a digit below zero
    nearest = (around(len(share), share[0]) == 0).to(share.dtype)
    share = share + NEAREST_GUARD_SHARE * nearest
    return share / share.sum(0)


def _erf_integral(t: Tensor) -> Tensor:
    """Return the integral of the error function up to t, times the root of pi, up to a constant."""
    bell = torch.exp((-t * t).clamp(min=MIN_EXPONENT))
    return torch.addcmul(bell, t, torch.erf(t), value=math.sqrt(math.pi))
