"""What is left of a harmonic of the panel in a binned reading, in closed form.

A harmonic of frequency f (cycles per sensor pixel, along one axis) is read by the sensor pixels of
one colour, every second pixel of a row: it is seen at frequencies g = f - m / 2, for every whole m.
Interpolation between them leaves cos^2(pi g) of each, holding each value over its pixel sinc(g),
and the mean over the s sensor pixels of a photo pixel sinc(s g). So the photo pixel in whose middle
the sensor coordinate is U reads

    sum over m of cos(pi g)^2 sinc(g) sinc(s g) exp(2 pi i (f U - m (U - o) / 2)),

o being where the colour's first pixel lies, 1/2 or 3/2. The four m with |g| < 1 are summed: sinc(g)
vanishes where one of them gives way to the next; what is farther away is the grain of held values,
a few hundredths at most. Below s = 1 the photo interpolates between sensor pixels, which is sinc(g)
once more instead of sinc(s g).

Along two axes the factors multiply for red and blue. Green pixels lie on a quincunx, whose aliases
are those of even m_u + m_v, each interpolated by (cos^2(pi g_u) + cos^2(pi g_v)) / 2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.numeric import sinc

Wave = tuple[Tensor, Tensor]  # real and imaginary part
ALIASES = 4


class AliasSums(NamedTuple):
    """The aliases of harmonics along one axis, added up: as interpolated between the pixels of
    rows that begin at o = 1/2 (`even`) and at o = 3/2 (`odd`), and without interpolation."""

    even: Wave
    odd: Wave
    bare_even: Wave
    bare_odd: Wave


def alias_sums(frequency: Tensor, scale: Tensor, at: Tensor) -> AliasSums:
    """Return the AliasSums along one axis, relative to exp(2 pi i f U).

    Args:
        frequency: (K, B, h, w) cycles per sensor pixel.
        scale: (B, 1, 1) sensor pixels per photo pixel.
        at: (B, h or 1, w or 1) float64, U, in sensor pixels.

    Differentiable in all of them.
    """
    dtype, wide = frequency.dtype, scale.clamp(min=1).to(frequency.dtype)
    first = (2 * frequency.detach()).floor() - 1
    sums: list[Wave] = []
    for j in range(ALIASES):
        m = first + j
        g = frequency - m / 2
        bare = sinc(g) * sinc(wide * g)
        interpolated = bare * torch.cos(math.pi * g).square()
        cycles = m.double() * ((0.5 - at) / 2)
        phase = 2 * math.pi * (cycles - cycles.detach().round()).to(dtype)
        cos, sin, sign = torch.cos(phase), torch.sin(phase), 1 - 2 * m.remainder(2)
        alias = []
        for weight in (interpolated, interpolated * sign, bare, bare * sign):
            alias.append((weight * cos, weight * sin))
        sums = [plus(*pair) for pair in zip(sums, alias, strict=True)] if sums else alias
    return AliasSums(*sums)


def in_plane(colour: int | None, u: AliasSums, v: AliasSums) -> Wave:
    """Return what the plane of a Bayer sensor's colour, or of a sensor without colour filters
    (None), reads of harmonics, from their aliases along both axes."""
    if colour == 0:
        return times(u.even, v.even)
    if colour == 2:
        return times(u.odd, v.odd)
    if colour is None:
        return times(_mean(u.bare_even, u.bare_odd), _mean(v.bare_even, v.bare_odd))
    upper = _mean(times(u.odd, v.bare_even), times(u.bare_odd, v.even))
    lower = _mean(times(u.even, v.bare_odd), times(u.bare_even, v.odd))
    return _mean(upper, lower)


def power_left(u: Tensor, v: Tensor, scale: Tensor, colour: int | None) -> Tensor:
    """Return which share of the power of harmonics of frequencies u and v (K, B) is left in a
    colour's plane, on average over where a bin lies: (K, B). Arguments as in `alias_sums` and
    `in_plane`."""
    found, wide = [], scale.clamp(min=1)
    steps = torch.arange(ALIASES, dtype=u.dtype, device=u.device)[:, None, None] - 1
    for frequency in (u, v):
        m = (2 * frequency.detach()).floor() + steps
        g = frequency - m / 2
        found.append((m, sinc(g) * sinc(wide * g), torch.cos(math.pi * g).square()))
    (m_u, bare_u, in_u), (m_v, bare_v, in_v) = found
    seen, even = bare_u[:, None] * bare_v, (m_u[:, None] + m_v) % 2 == 0
    if colour is None:
        seen = seen * (even & (m_v % 2 == 0))
    elif colour == 1:
        seen = seen * even * (in_u[:, None] + in_v) / 2
    else:
        seen = seen * in_u[:, None] * in_v
    return seen.square().sum((0, 1))


def times(a: Wave, b: Wave) -> Wave:
    """Return the product of two complex numbers."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def plus(a: Wave, b: Wave) -> Wave:
    """Return the sum of two complex numbers."""
    return a[0] + b[0], a[1] + b[1]


def _mean(a: Wave, b: Wave) -> Wave:
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2
