"""The shares of a sensor pixel's view that fall on the panel's cells around it, along one axis, as
in `moireaug.camera.exposure.footprint`; float32.

A view is a box convolved with a Gaussian. What of it lies beyond a point is the mean, over the box,
of the normal distribution function: a ramp, and a tail around each end of the box. So computed, a
small box loses no digits, as it does by differences of the integral.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl
from numpy.polynomial import Polynomial

from moireaug.camera.exposure import footprint as reference
from moireaug.common.physics import footprint as formulas
from moireaug.engine.gpu.optics import MIN_EXPONENT
from moireaug.engine.gpu.physics import footprint as view

MIN_BLUR_VARIANCE = tl.constexpr(formulas.MIN_BLUR_VARIANCE)
NEAREST_GUARD_SHARE = tl.constexpr(reference.NEAREST_GUARD_SHARE)
FAR_SIGMAS = tl.constexpr(8.0)  # beyond which no light is


def _tail_share(z: float) -> float:
    """Return `_tail` as a share of the bell exp(-z^2 / 2)."""
    bell, beyond = math.exp(-z * z / 2), 0.5 * math.erfc(z * 0.5**0.5)
    return (2 * math.pi) ** -0.5 - z * beyond / bell


# as a polynomial in 1 / (1 + TAIL_SCALE z): times the bell, right to 6e-8
_scale = 0.4
_t = 1 - (1 - 1 / (1 + _scale * 8)) * (1 + np.cos(np.pi * (np.arange(64) + 0.5) / 64)) / 2
_z = (1 / _t - 1) / _scale
_fitted = Polynomial.fit(_t, [_tail_share(z) for z in _z], 6, w=np.exp(-(_z**2) / 2) + 1e-3)
TAIL_SCALE = tl.constexpr(_scale)
T0, T1, T2, T3, T4, T5, T6 = (tl.constexpr(float(c)) for c in _fitted.convert().coef)


class Footprint(NamedTuple):
    """The view of a sensor pixel along one axis: a box, and a Gaussian's standard deviation, in
    cells."""

    box: Any
    sigma: Any


@triton.jit
def _tail(z):
    """Return the integral of the standard normal distribution function up to -z, z >= 0."""
    root = tl.rsqrt(z * TAIL_SCALE + 1.0)
    t = root * root
    bell = tl.exp(tl.maximum(-0.5 * z * z, MIN_EXPONENT))
    return bell * (t * (T1 + t * (T2 + t * (T3 + t * (T4 + t * (T5 + t * T6))))) + T0)


@triton.jit
def share_beyond(edge, footprint):
    """Return the share of a view that lies beyond an edge, at a distance from its middle."""
    near, far = edge - 0.5 * footprint.box, edge + 0.5 * footprint.box
    inverse = 1.0 / footprint.sigma
    ramp = tl.maximum(-near, 0.0) - tl.maximum(-far, 0.0)
    tails = _tail(tl.abs(near) * inverse) - _tail(tl.abs(far) * inverse)
    return (ramp + footprint.sigma * tails) / footprint.box


@triton.jit
def share_between(distance, half, footprint):
    """Return the share of a view within `half` of a point at a distance from its middle."""
    apart = tl.abs(distance)  # where what lies beyond is small, it has more digits
    share = share_beyond(apart - half, footprint) - share_beyond(apart + half, footprint)
    return tl.maximum(share, 0.0)


@triton.jit
def tap_shares(offset, footprint, width, TAPS: tl.constexpr):
    """Return the share of each of TAPS subpixels in the light of all of them, a tuple.

    Args:
        offset: of the view's middle from the nearest subpixel's, cells. width: of a subpixel,
            cells.
    """
    shares, total = (), NEAREST_GUARD_SHARE + 0.0 * offset
    for tap in tl.static_range(TAPS):
        share = share_between(tap - TAPS // 2 - offset, 0.5 * width, footprint)
        total += share
        if tap == TAPS // 2:
            share += NEAREST_GUARD_SHARE
        shares = shares + (share,)
    normalised, unit = (), 1.0 / total
    for tap in tl.static_range(TAPS):
        normalised = normalised + (shares[tap] * unit,)
    return normalised


@triton.jit
def share_on_picture(position, end, footprint):
    """Return the share of a view that is on the picture, from 0 to `end`; float64, cells."""
    far = 0.5 * footprint.box + FAR_SIGMAS * footprint.sigma
    to_start, to_end = position.to(tl.float32), (position - end).to(tl.float32)
    past_start = share_beyond(-tl.minimum(tl.maximum(to_start, -far), far), footprint)
    return past_start - share_beyond(-tl.minimum(tl.maximum(to_end, -far), far), footprint)


@triton.jit
def lit_shares(place, footprint, width, picture, TAPS: tl.constexpr, DARK_AROUND: tl.constexpr):
    """Return the nearest cell, float64, and the shares of TAPS cells around it, those beside the
    picture being DARK_AROUND.

    Args:
        place: of the view's middle, float64, in cells from the middle of the light of cell 0.
        width: of the light, cells. picture: where the view's middle and cell 0's pixel lie from the
            picture's start, and the picture's end, in cells.
    """
    nearest = tl.floor(place + 0.5)
    offset, end = (place - nearest).to(tl.float32), 0.5 * TAPS
    narrowed = view.narrowing(footprint.box, footprint.sigma, width, end)
    fitted = Footprint(footprint.box * narrowed, footprint.sigma * narrowed)
    shares = tap_shares(offset, fitted, width, TAPS)
    if DARK_AROUND:
        position, pixel, end = picture
        whole, lit = share_on_picture(position, end, footprint), ()
        for tap in tl.static_range(TAPS):
            at = nearest + (tap - TAPS // 2) + pixel
            alone = tl.where((at >= 0.0) & (at < end), 1.0, 0.0)
            # a view that is not narrowed sees each pixel by itself
            lit = lit + (shares[tap] * tl.where(narrowed < 1.0, whole, alone),)
        shares = lit
    return nearest, shares
