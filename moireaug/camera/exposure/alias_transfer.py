"""The transfer of a harmonic of the panel to a binned reading, in closed form.

A harmonic of frequency f (cycles per sensor pixel, along u and v) is read by the sensor pixels of
one colour, every second pixel of a row: it is seen at frequencies g = f - m / 2, for every pair m
of whole numbers. Interpolation between the pixels leaves cos^2(pi g_u) cos^2(pi g_v) of each,
holding each value over its pixel sinc(g_u) sinc(g_v), and the mean over a bin whose sides are the
vectors a and b (in sensor pixels) sinc(g . a) sinc(g . b). So the bin in whose middle the sensor
coordinates are U reads

    sum over m of cos^2(pi g_u) cos^2(pi g_v) sinc(g_u) sinc(g_v) sinc(g . a) sinc(g . b)
                  exp(2 pi i (f . U - m . (U - o) / 2)),

o being where the colour's first pixel lies, 1/2 or 3/2 along each axis. The four m with |g| < 1 are
summed along each axis: sinc(g) vanishes where one of them gives way to the next; those farther
away are the grain of held values, a few hundredths at most.

A photo that is shrunk by a triangle filter, twice as wide as a bin (`Develop.resize` "antialias"),
has the last two factors squared.

Green pixels lie on a quincunx, whose aliases are those of even m_u + m_v, each interpolated by
(cos^2(pi g_u) + cos^2(pi g_v)) / 2. Pixels without colour filters lie a pixel apart: their aliases
are those of even m.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.common.numeric import sinc
from moireaug.common.tensor_physics import aliases as formulas

Wave = tuple[Tensor, Tensor]  # real and imaginary part
ALIASES_PER_AXIS = 4  # of pixels two apart


class Aliases(NamedTuple):
    """The n aliases of harmonics along an axis, (n, ...) each: their frequencies g; the transfer of
    holding values over pixels, and of interpolation between them; their signs for pixels that begin
    at o = 3/2; and exp(-2 pi i m (U - 1/2) / 2)."""

    frequency: Tensor
    hold: Tensor
    interpolation: Tensor
    sign: Tensor
    real: Tensor
    imaginary: Tensor

    def one(self, i: int) -> Aliases:
        """Return one of them."""
        return Aliases(*(values[i] for values in self))


def aliases(frequency: Tensor, at: Tensor, *, bayer: bool) -> Aliases:
    """Return the aliases along one axis.

    Args:
        frequency: (K, B, h, w) cycles per sensor pixel.
        at: (B, h, w) float64, U, in sensor pixels.
        bayer: whether the pixels of a colour lie two apart.
    """
    step = 1 if bayer else 2
    first = (2 / step * frequency.detach()).floor() * step - (1 if bayer else 0)
    steps = torch.arange(0, ALIASES_PER_AXIS, step, dtype=first.dtype, device=first.device)
    m = first + steps.reshape(-1, *[1] * frequency.ndim)
    g, sign = frequency - m / 2, 1 - 2 * m.remainder(2)
    cycles = m.double() * ((0.5 - at) / 2)
    phase = 2 * math.pi * (cycles - cycles.detach().round()).to(frequency.dtype)
    even = torch.cos(math.pi * frequency).square()
    interpolation = formulas.interpolation_transfer(even, sign < 0)
    return Aliases(g, sinc(g), interpolation, sign, torch.cos(phase), torch.sin(phase))


def plane_waves(
    u: Tensor, v: Tensor, centre: Tensor, sides: Tensor, triangle: Tensor | float, *, bayer: bool
) -> list[Wave]:
    """Return the waves that the planes of red, green and blue read of harmonics, relative to
    exp(2 pi i f . U), (K, B, h, w) each; without colour filters, one wave for all. Differentiable
    in all tensors.

    Args:
        u, v: (K, B, h, w), the harmonics' frequencies along both axes.
        centre, sides, triangle: of the bins, see `bin_geometry.Bins`.
    """
    none = torch.zeros_like(u), torch.zeros_like(u)
    red, green, blue = none, none, none
    along_u = aliases(u, centre[..., 0], bayer=bayer)
    b = aliases(v, centre[..., 1], bayer=bayer)
    for i in range(len(along_u.sign)):
        a = along_u.one(i)
        transfer = a.hold * b.hold * _bin_transfer(a.frequency, b.frequency, sides, triangle)
        wave = times((a.real, a.imaginary), (b.real, b.imaginary))
        if not bayer:
            red = plus(red, weighted_sum(transfer, wave))
            continue
        coloured, quincunx = _interpolated(transfer, a, b)
        red = plus(red, weighted_sum(coloured, wave))
        green = plus(green, weighted_sum(quincunx * a.sign, wave))
        blue = plus(blue, weighted_sum(coloured * a.sign * b.sign, wave))
    return [red, green, blue] if bayer else [red]


def power_transfer(
    u: Tensor, v: Tensor, sides: Tensor, triangle: Tensor | float, *, bayer: bool
) -> list[Tensor]:
    """Return the share of the power of harmonics of frequencies u and v (K, B) that each plane
    reads, on average over where a bin lies: (K, B) each. sides: (B, 2, 2); the rest as in
    `plane_waves`."""
    at = sides.new_zeros(len(sides))
    a, b = (aliases(f, at, bayer=bayer) for f in (u, v))
    a = Aliases(*(values[:, None] for values in a))
    transfer = a.hold * b.hold * _bin_transfer(a.frequency, b.frequency, sides, triangle)
    if not bayer:
        return [transfer.square().sum((0, 1))]
    red, green = (share.square().sum((0, 1)) for share in _interpolated(transfer, a, b))
    return [red, green, red]


def times(a: Wave, b: Wave) -> Wave:
    """Return the product of two complex numbers."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def plus(a: Wave, b: Wave) -> Wave:
    """Return the sum of two complex numbers."""
    return a[0] + b[0], a[1] + b[1]


def weighted_sum(weight: Tensor, a: Wave) -> Wave:
    """Return the weighted sum of complex numbers (n, ...)."""
    return (weight * a[0]).sum(0), (weight * a[1]).sum(0)


def _bin_transfer(u: Tensor, v: Tensor, sides: Tensor, triangle: Tensor | float) -> Tensor:
    """Return the transfer of the mean over a bin at frequencies u and v."""
    first, second = (u * sides[..., 0, side] + v * sides[..., 1, side] for side in (0, 1))
    mean = formulas.mean_over_sides(1.0, first, second)
    return formulas.mean_over_sides(mean, triangle * first, triangle * second)


def _interpolated(transfer: Tensor, a: Aliases, b: Aliases) -> tuple[Tensor, Tensor]:
    """Return what interpolation leaves of aliases in the planes of red and of green, but for their
    signs."""
    coloured, quincunx = formulas.plane_transfers(
        a.interpolation, b.interpolation, a.sign < 0, b.sign < 0
    )
    return transfer * coloured, transfer * quincunx
