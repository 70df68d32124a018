"""The shares of a sensor pixel's view that fall on the panel's cells around it, along one axis, as
in `moireaug.exposure.footprint`; float32.

A view is a box convolved with a Gaussian. What of it lies beyond a point is the mean, over the box,
of the normal distribution function: a ramp, and a tail around each end of the box. So computed, a
small box loses no digits, as it does by differences of the integral.
"""

from __future__ import annotations

import math

import triton
import triton.language as tl

from moireaug.engine.gpu.transfer import FILL, blur_variance
from moireaug.engine.gpu.view import load32
from moireaug.exposure import footprint as reference

MIN_BLUR_VARIANCE = tl.constexpr(reference.MIN_BLUR_VARIANCE)
TAIL_SIGMAS = tl.constexpr(reference.TAIL_SIGMAS)
NEAREST_GUARD_SHARE = tl.constexpr(reference.NEAREST_GUARD_SHARE)
MIN_EXPONENT = tl.constexpr(reference.MIN_EXPONENT)
ROOT_HALF = tl.constexpr(0.5**0.5)
PEAK = tl.constexpr((2 * math.pi) ** -0.5)  # of the standard normal density


@triton.jit
def footprint(by_u, by_v, period, slant_variance, camera):
    """Return the box and the standard deviation of a view along one axis, in cells.

    Args:
        by_u, by_v: panel pixels per sensor pixel along u and v. period: of the cells, panel pixels.
        slant_variance: of the subpixels, squared cells.
    """
    fill, across, down = load32(camera, FILL), tl.abs(by_u), tl.abs(by_v)
    box, short = tl.maximum(across, down) * fill / period, tl.minimum(across, down) * fill
    variance = short * short / 12.0 + blur_variance(by_u, by_v, camera)
    variance = variance / (period * period) + slant_variance + MIN_BLUR_VARIANCE
    return box, tl.sqrt(variance)


@triton.jit
def narrowing(box, sigma, width, TAPS: tl.constexpr):
    """Return the factor that narrows a view to TAPS cells, as `Footprint.fitted` does."""
    room = tl.maximum(0.5 * TAPS - 0.5 * width, MIN_BLUR_VARIANCE)
    return tl.minimum(room / (0.5 * box + TAIL_SIGMAS * sigma), 1.0)


@triton.jit
def _tail(z):
    """Return the integral of the standard normal distribution function up to -z, z >= 0."""
    density = PEAK * tl.exp(tl.maximum(-0.5 * z * z, MIN_EXPONENT))
    return tl.maximum(density - z * (0.5 - 0.5 * tl.erf(z * ROOT_HALF)), 0.0)


@triton.jit
def share_beyond(edge, box, sigma):
    """Return the share of a view that lies beyond an edge, at a distance from its middle."""
    near, far = edge - 0.5 * box, edge + 0.5 * box
    ramp = tl.maximum(-near, 0.0) - tl.maximum(-far, 0.0)
    tails = _tail(tl.abs(near) / sigma) - _tail(tl.abs(far) / sigma)
    return (ramp + sigma * tails) / box


@triton.jit
def share_between(distance, half, box, sigma):
    """Return the share of a view within `half` of a point at a distance from its middle."""
    apart = tl.abs(distance)  # where what lies beyond is small, it has more digits
    share = share_beyond(apart - half, box, sigma) - share_beyond(apart + half, box, sigma)
    return tl.maximum(share, 0.0)


@triton.jit
def tap_shares(offset, box, sigma, width, TAPS: tl.constexpr):
    """Return the share of each of TAPS subpixels in the light of all of them, a tuple.

    Args:
        offset: of the view's middle from the nearest subpixel's, cells. width: of a subpixel,
            cells.
    """
    shares, total = (), NEAREST_GUARD_SHARE + 0.0 * offset
    for tap in tl.static_range(TAPS):
        share = share_between(tap - TAPS // 2 - offset, 0.5 * width, box, sigma)
        total += share
        if tap == TAPS // 2:
            share += NEAREST_GUARD_SHARE
        shares = shares + (share,)
    normalised, unit = (), 1.0 / total
    for tap in tl.static_range(TAPS):
        normalised = normalised + (shares[tap] * unit,)
    return normalised
