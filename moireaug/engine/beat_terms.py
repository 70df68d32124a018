"""The terms of beats: which aliases of which harmonics a binned reading shows, and how strong they
are at nodes of the photo.

A term is a harmonic (k, l) and an alias (m_u, m_v); see `exposure.binning`.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import optics
from moireaug.engine.beat_grid import (
    FAINT_BEAT,
    MOST_NODES,
    node_counts,
    sampled_grid,
    transfer_of,
)
from moireaug.engine.compiling import inner, loop
from moireaug.engine.nodes import SAMPLES

UNKNOWN = 2.0  # no transfer is
SAFETY = 1.2  # how much more of a harmonic may pass between the samples
MOST_TERMS = 1024
LOBES, STEPS = 64, 32  # of the table of sinc, and steps of each
SINC = np.sinc(np.arange(LOBES * STEPS + 2) / STEPS)
ZERO = np.float32(0)


@inner
def sinc(x):
    """Return sin(pi x) / (pi x)."""
    x = abs(x)
    return optics.transfer(SINC, x * STEPS) if x < LOBES else math.sin(math.pi * x) / (math.pi * x)


@loop
def brightest(grid, strength, table, steps, camera):
    """Return the most that each harmonic makes of a reading, (K,)."""
    out = np.empty(len(strength), np.float64)
    for h in range(len(strength)):
        passed = _most_transmitted(grid.frequency, h, table, steps, camera)
        out[h] = strength[h] * passed * max(camera.gain, 1.0)
    return out


@loop
def fits(sites, camera, enlargement, triangle, period, orders, strength):
    """Return whether the kernels can follow a view: not one whose beats change too fast, or are too
    many."""
    grid = sampled_grid(sites, camera, enlargement, triangle, period, orders)
    table, steps = transfer_of(grid, camera)
    amplitude = brightest(grid, strength, table, steps, camera)
    across, down = node_counts(grid, amplitude, sites, camera)
    return len(candidates(grid, amplitude)) < MOST_TERMS and max(across, down) <= MOST_NODES


@inner
def transmitted(fu, fv, table, steps, camera):
    """Return what aperture and lens leave of a frequency."""
    passed = optics.transfer(table, abs(fu) * steps) * optics.transfer(table, abs(fv) * steps)
    if camera.motion_x != 0 or camera.motion_y != 0:
        along = fu * camera.motion_x + fv * camera.motion_y
        passed *= math.exp(-2 * math.pi * math.pi * along * along)
    return passed


@inner
def _most_transmitted(frequency, h, table, steps, camera):
    """Return about the most that aperture and lens leave of a harmonic, at every fourth sample."""
    most = 0.0
    for i in range(0, SAMPLES, 4):
        for j in range(0, SAMPLES, 4):
            fu, fv = frequency[i, j, h, 0], frequency[i, j, h, 1]
            most = max(most, abs(transmitted(fu, fv, table, steps, camera)))
    return min(SAFETY * most, 1.0)


@loop
def _doubled(terms):
    """Return terms (T, 3) with room for as many more."""
    out = np.empty((2 * len(terms), 3), np.int64)
    for t in range(len(terms)):
        for j in range(3):
            out[t, j] = terms[t, j]
    return out


@inner
def _fill_ranges(ranges, grid, h):
    """Fill ranges (4, 2) with the lowest and the highest frequency of a harmonic along u and v, and
    cycles along the two sides of a bin."""
    rows, cols = grid.sides.shape[:2]
    for r in range(rows):
        for c in range(cols):
            (fu, fv), side = grid.frequency[r, c, h], grid.sides[r, c]
            values = (fu, fv, fu * side[0] + fv * side[1], fu * side[2] + fv * side[3])
            for j in range(4):
                if r == 0 and c == 0:
                    ranges[j, 0] = ranges[j, 1] = values[j]
                ranges[j, 0] = min(ranges[j, 0], values[j])
                ranges[j, 1] = max(ranges[j, 1], values[j])


@inner
def _fill_side_ranges(out, sides):
    """Fill out (4, 2) with the least and the greatest of the sides' coordinates."""
    rows, cols, _ = sides.shape
    for j in range(4):
        out[j, 0] = out[j, 1] = sides[0, 0, j]
        for r in range(rows):
            for c in range(cols):
                out[j, 0], out[j, 1] = (
                    min(out[j, 0], sides[r, c, j]),
                    max(out[j, 1], sides[r, c, j]),
                )


@inner
def _nearest(low, high):
    """Return the least magnitude in a range."""
    return 0.0 if low <= 0 <= high else min(abs(low), abs(high))


@inner
def _most_held(low, high, m):
    """Return the most that holding leaves of an alias m of frequencies from `low` to `high`."""
    nearest = _nearest(low - m / 2, high - m / 2)
    return max(1 - nearest * nearest, 0.0)


@inner
def _most_of_side(cycles, side_u, side_v, m_u, m_v):
    """Return the most that the mean along a side leaves of an alias, by the ranges of a harmonic's
    cycles along it, and of the side's coordinates."""
    u = (m_u * side_u[0] / 2, m_u * side_u[1] / 2)
    v = (m_v * side_v[0] / 2, m_v * side_v[1] / 2)
    low = cycles[0] - max(u[0], u[1]) - max(v[0], v[1])
    high = cycles[1] - min(u[0], u[1]) - min(v[0], v[1])
    return min(1.0, 1 / (math.pi * _nearest(low, high) + 1e-9))


@loop
def candidates(grid, amplitude):
    """Return the terms (T, 3) int64, harmonic and alias along both axes, that may exceed
    FAINT_BEAT, MOST_TERMS where there are as many or more.

    grid: from `sampled_grid`, so that its ends are about those over the photo. amplitude: from
    `brightest`.
    """
    count, n = 0, grid.frequency.shape[2]
    out = np.empty((64, 3), np.int64)
    ranges, side = np.empty((4, 2), np.float64), np.empty((4, 2), np.float64)
    _fill_side_ranges(side, grid.sides)
    for h in range(n):
        if amplitude[h] <= FAINT_BEAT:
            continue
        _fill_ranges(ranges, grid, h)
        (low_u, high_u), (low_v, high_v) = ranges[0], ranges[1]
        if max(high_u - low_u, high_v - low_v) > MOST_TERMS / 2:
            return np.zeros((MOST_TERMS, 3), np.int64)
        least = FAINT_BEAT / max(amplitude[h], 1e-30)
        for m_u in range(math.floor(2 * low_u) - 1, math.floor(2 * high_u) + 3):
            held = _most_held(low_u, high_u, m_u)
            if held <= least:
                continue
            for m_v in range(math.floor(2 * low_v) - 1, math.floor(2 * high_v) + 3):
                left = held * _most_held(low_v, high_v, m_v)
                left *= _most_of_side(ranges[2], side[0], side[1], m_u, m_v)
                if left * _most_of_side(ranges[3], side[2], side[3], m_u, m_v) <= least:
                    continue
                if count == MOST_TERMS:
                    return out
                if count == len(out):
                    out = _doubled(out)
                out[count, 0], out[count, 1], out[count, 2] = h, m_u, m_v
                count += 1
    return out[:count]


@loop
def harmonics_of(terms):
    """Return the harmonics of sorted terms, (H,), and number the terms' own by their places."""
    out, count = np.empty(len(terms), np.int64), 0
    for t in range(len(terms)):
        if count == 0 or terms[t, 0] != out[count - 1]:
            out[count] = terms[t, 0]
            count += 1
        terms[t, 0] = count - 1
    return out[:count]


@inner
def left_of(fu, fv, m_u, m_v, side, triangle):
    """Return what is left of an alias without interpolation; side: (4,), of the bin. triangle: see
    `exposure.bins.Bins`."""
    u, v = fu - m_u / 2, fv - m_v / 2
    if abs(u) >= 1 or abs(v) >= 1:
        return 0.0
    first, second = u * side[0] + v * side[1], u * side[2] + v * side[3]
    left = sinc(u) * sinc(v) * sinc(first) * sinc(second)
    if triangle != 0:
        left *= sinc(triangle * first) * sinc(triangle * second)
    return left


@inner
def interpolated(even, m):
    """Return what interpolation leaves of an alias, from what it leaves of even ones."""
    return even if m % 2 == 0 else 1 - even


@inner
def in_planes(even_u, even_v, m_u, m_v, bayer):
    """Return what interpolation leaves of an alias in the planes of red and blue, and of green;
    without colour filters, in all."""
    in_u, in_v = interpolated(even_u, m_u), interpolated(even_v, m_v)
    even = (m_u + m_v) % 2 == 0
    if bayer:
        return in_u * in_v, (in_u + in_v) / 2 if even else 0.0
    alone = 1.0 if even and m_u % 2 == 0 else 0.0
    return alone, alone


@loop
def amplitudes(grid, terms, least, table, steps, camera, bayer):
    """Return (rows, cols, T, 2) float32, each term's amplitude at nodes, as the planes of red and
    blue, and of green, read it. Terms are sorted; of those of a harmonic that are below `least`
    (H,), some are 0. table, steps: from `transfer_of`."""
    rows, cols = grid.sides.shape[:2]
    out = np.empty((rows, cols, len(terms), 2), np.float32)
    for r in range(rows):
        for c in range(cols):
            last, passed, even_u, even_v, side = -1, UNKNOWN, 0.0, 0.0, grid.sides[r, c]
            for t in range(len(terms)):
                h, m_u, m_v = terms[t, 0], terms[t, 1], terms[t, 2]
                if h != last:
                    last, passed = h, UNKNOWN
                fu, fv = grid.frequency[r, c, h, 0], grid.frequency[r, c, h, 1]
                out[r, c, t, 0] = out[r, c, t, 1] = ZERO
                left = left_of(fu, fv, m_u, m_v, side, grid.triangle)
                if abs(left) < least[h]:
                    continue
                if passed == UNKNOWN:
                    passed = transmitted(fu, fv, table, steps, camera)
                    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
                coloured, green = in_planes(even_u, even_v, m_u, m_v, bayer)
                out[r, c, t, 0], out[r, c, t, 1] = passed * left * coloured, passed * left * green
    return out


@loop
def strong(amplitude, terms, strength):
    """Return which terms exceed FAINT_BEAT at any node; strength: (H,), of harmonics in a
    reading."""
    rows, cols, n, _ = amplitude.shape
    out, count = np.empty(n, np.int64), 0
    for t in range(n):
        most = ZERO
        for r in range(rows):
            for c in range(cols):
                most = max(most, abs(amplitude[r, c, t, 0]), abs(amplitude[r, c, t, 1]))
        if most * strength[terms[t, 0]] > FAINT_BEAT:
            out[count] = t
            count += 1
    return out[:count]
