"""The blur of a sensor pixel's view by aperture, point spread and low-pass filter, in space and in
frequency, and the share of the view that falls on each panel pixel around it.

Aperture and point spread, projected on an axis of the panel, are a box and a Gaussian around it; a
subpixel is a box, too. Their convolution is the share of light from each panel pixel, in closed
form. Taking each axis alone is exact for an upright view, and for the second moments of any view,
which are all that a picture's detail needs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.common.physics.footprint import MIN_BLUR_VARIANCE
from moireaug.common.tensor_physics import footprint, optics
from moireaug.scene.shot_geometry import ShotGeometry

GOLDEN_RATIO = 0.6180339887498949
PLASTIC_NUMBER = 1.324717957244746

# share of the nearest panel pixel where none is seen, so that shares can be normalised
NEAREST_GUARD_SHARE = 1e-9
MIN_EXPONENT = -80.0  # not far below, float32 numbers are denormal and many times slower
# squared cells: its product with a shrinking may be 0 in float32, whose power of -3/2 is infinite
MIN_NARROWED_VARIANCE = 1e-20
# standard deviations of the spread: of a much narrower box, float32 holds no difference of its ends
MIN_BOX_SIGMAS = 1e-3


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
