"""The terms of beats: which aliases of which harmonics a binned reading shows, and how strong they
are at nodes of the photo.

A term is a harmonic (k, l) and an alias (m_u, m_v); see `exposure.alias_transfer`.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.common.physics.binding import bind
from moireaug.engine.cpu import optics
from moireaug.engine.cpu.beat_grid import MAX_BEAT_NODES, node_counts, sampled_grid, transfer_of
from moireaug.engine.cpu.coarse_grid import VIEW_SAMPLES
from moireaug.engine.cpu.compiling import jit, jit_in_place
from moireaug.engine.cpu.physics import OPERATIONS
from moireaug.engine.lower.budget import MAX_MOTION_RANGE, TRANSFER_MARGIN

# limits; the reference exposes what is beyond them
MAX_BEAT_TERMS = 32768
MAX_BEAT_AMPLITUDES = 2**25  # of all terms at all nodes
MAX_FREQUENCY_RANGE = 512.0  # of a harmonic over the photo, cycles per sensor pixel

UNKNOWN_TRANSFER = 2.0  # above any transfer
SINC_LOBES, STEPS_PER_LOBE = 64, 32
SINC_TABLE = np.sinc(np.arange(SINC_LOBES * STEPS_PER_LOBE + 2) / STEPS_PER_LOBE)
ZERO = np.float32(0)
HARMONIC, ALIAS_U, ALIAS_V = range(3)  # columns of terms


@jit_in_place
def sinc(x):
    """Return sin(pi x) / (pi x)."""
    x = abs(x)
    if x < SINC_LOBES:
        return optics.look_up(SINC_TABLE, x * STEPS_PER_LOBE)
    return math.sin(math.pi * x) / (math.pi * x)


aliases = bind("aliases", OPERATIONS | {"sinc": sinc}, jit_in_place)


@jit
def max_amplitudes(grid, strength, table, steps_per_cycle, camera):
    """Return about the highest amplitude of each harmonic in a reading, (K,): aperture and lens
    pass what they pass at every fourth sample, and a little more."""
    out, frequency = np.empty(len(strength), np.float64), grid.frequency
    for h in range(len(strength)):
        most, most_still, low, high = 0.0, 0.0, math.inf, -math.inf
        for i in range(0, VIEW_SAMPLES, 4):
            for j in range(0, VIEW_SAMPLES, 4):
                fu, fv = frequency[i, j, h, 0], frequency[i, j, h, 1]
                most = max(most, abs(optics.transfer_at(fu, fv, table, steps_per_cycle, camera)))
                still = abs(optics.still_transfer_at(fu, fv, table, steps_per_cycle))
                along = fu * camera.motion_x + fv * camera.motion_y
                most_still, low, high = max(most_still, still), min(low, along), max(high, along)
        # motion passes waves along which it runs, which may be between the samples
        if low < 0 < high and high - low > MAX_MOTION_RANGE:
            most = most_still
        out[h] = strength[h] * min(TRANSFER_MARGIN * most, 1.0) * max(camera.gain, 1.0)
    return out


@jit
def can_follow_beats(sites, camera, b, i, budget):
    """Return whether the kernels can follow the view of image i: not if its beats change too fast,
    or are too many; b: see `exposure_records.Beats`."""
    grid = sampled_grid(sites, camera, b, i)
    table, steps_per_cycle = transfer_of(grid, camera)
    amplitude = max_amplitudes(grid, b.strength[i], table, steps_per_cycle, camera)
    across, down = node_counts(grid, amplitude, sites, camera, budget)
    terms = len(candidate_terms(grid, amplitude, budget.beat_amplitude))
    few = terms < MAX_BEAT_TERMS and terms * across * down <= MAX_BEAT_AMPLITUDES
    return few and max(across, down) <= MAX_BEAT_NODES


@jit_in_place
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


@jit_in_place
def _fill_side_ranges(out, sides):
    """Fill out (4, 2) with the least and the greatest of the sides' coordinates."""
    rows, cols, _ = sides.shape
    for j in range(4):
        out[j, 0] = out[j, 1] = sides[0, 0, j]
        for r in range(rows):
            for c in range(cols):
                out[j, 0] = min(out[j, 0], sides[r, c, j])
                out[j, 1] = max(out[j, 1], sides[r, c, j])


@jit
def candidate_terms(grid, amplitude, least):
    """Return the terms (T, 3) int64, harmonic and alias along both axes, that may exceed
    an amplitude of `least`, MAX_BEAT_TERMS where there are as many or more.

    grid: from `sampled_grid`, so that its ends are about those over the photo. amplitude: from
    `max_amplitudes`.
    """
    count, n = 0, grid.frequency.shape[2]
    out = np.empty((MAX_BEAT_TERMS, 3), np.int64)
    ranges, side = np.empty((4, 2), np.float64), np.empty((4, 2), np.float64)
    _fill_side_ranges(side, grid.sides)
    for h in range(n):
        if amplitude[h] <= least:
            continue
        _fill_ranges(ranges, grid, h)
        (low_u, high_u), (low_v, high_v) = ranges[0], ranges[1]
        if max(high_u - low_u, high_v - low_v) > MAX_FREQUENCY_RANGE:
            return np.zeros((MAX_BEAT_TERMS, 3), np.int64)
        least_transfer = least / max(amplitude[h], 1e-30)
        for m_u in range(math.floor(2 * low_u) - 1, math.floor(2 * high_u) + 3):
            transfer_u = aliases.max_hold_transfer(low_u, high_u, m_u)
            if transfer_u <= least_transfer:
                continue
            for m_v in range(math.floor(2 * low_v) - 1, math.floor(2 * high_v) + 3):
                transfer = transfer_u * aliases.max_hold_transfer(low_v, high_v, m_v)
                transfer *= aliases.max_mean_transfer(ranges[2], side[0], side[1], m_u, m_v)
                transfer *= aliases.max_mean_transfer(ranges[3], side[2], side[3], m_u, m_v)
                if transfer <= least_transfer:
                    continue
                if count == MAX_BEAT_TERMS:
                    return out
                out[count, HARMONIC], out[count, ALIAS_U], out[count, ALIAS_V] = h, m_u, m_v
                count += 1
    return out[:count]


@jit
def number_harmonics(terms):
    """Return the harmonics of sorted terms, (H,) int64, and replace the terms' own by their indices
    there."""
    out, count = np.empty(len(terms), np.int64), 0
    for t in range(len(terms)):
        if count == 0 or terms[t, HARMONIC] != out[count - 1]:
            out[count] = terms[t, HARMONIC]
            count += 1
        terms[t, HARMONIC] = count - 1
    return out[:count]


@jit_in_place
def alias_transfer(fu, fv, m_u, m_v, side, triangle):
    """Return the transfer of an alias before interpolation.

    side: (4,), of the bin. triangle: see `bin_geometry.Bins`.
    """
    u, v = fu - m_u / 2, fv - m_v / 2
    if abs(u) >= 1 or abs(v) >= 1:
        return 0.0
    first, second = u * side[0] + v * side[1], u * side[2] + v * side[3]
    transfer = aliases.mean_over_sides(sinc(u) * sinc(v), first, second)
    if triangle != 0:
        transfer *= aliases.mean_over_sides(1.0, triangle * first, triangle * second)
    return transfer


@jit_in_place
def plane_transfers(even_u, even_v, m_u, m_v, bayer):
    """Return the transfer of interpolation for an alias in the planes of red and blue, and in that
    of green; without colour filters, in all planes."""
    odd_u, odd_v = m_u % 2 != 0, m_v % 2 != 0
    if bayer:
        in_u = aliases.interpolation_transfer(even_u, odd_u)
        in_v = aliases.interpolation_transfer(even_v, odd_v)
        return aliases.plane_transfers(in_u, in_v, odd_u, odd_v)
    alone = 0.0 if odd_u or odd_v else 1.0
    return alone, alone


@jit
def amplitudes(grid, terms, least, table, steps_per_cycle, camera, bayer):
    """Return (rows, cols, T, 2) float32, each term's amplitude at nodes, as the planes of red and
    blue, and of green, read it. Terms are sorted; of those of a harmonic that are below `least`
    (H,), some are 0. table, steps_per_cycle: from `transfer_of`."""
    rows, cols = grid.sides.shape[:2]
    out = np.empty((rows, cols, len(terms), 2), np.float32)
    for r in range(rows):
        for c in range(cols):
            last, passed, even_u, even_v, side = -1, UNKNOWN_TRANSFER, 0.0, 0.0, grid.sides[r, c]
            for t in range(len(terms)):
                h, m_u, m_v = terms[t, HARMONIC], terms[t, ALIAS_U], terms[t, ALIAS_V]
                if h != last:
                    last, passed = h, UNKNOWN_TRANSFER
                fu, fv = grid.frequency[r, c, h, 0], grid.frequency[r, c, h, 1]
                out[r, c, t, 0] = out[r, c, t, 1] = ZERO
                transfer = alias_transfer(fu, fv, m_u, m_v, side, grid.triangle)
                if abs(transfer) < least[h]:
                    continue
                if passed == UNKNOWN_TRANSFER:
                    passed = optics.transfer_at(fu, fv, table, steps_per_cycle, camera)
                    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
                coloured, green = plane_transfers(even_u, even_v, m_u, m_v, bayer)
                transfer *= passed
                out[r, c, t, 0], out[r, c, t, 1] = transfer * coloured, transfer * green
    return out


@jit
def strong_terms(amplitude, terms, strength, least):
    """Return which terms exceed `least` at any node; strength: (H,), of harmonics in a
    reading."""
    rows, cols, n, _ = amplitude.shape
    out, count = np.empty(n, np.int64), 0
    for t in range(n):
        most = ZERO
        for r in range(rows):
            for c in range(cols):
                most = max(most, abs(amplitude[r, c, t, 0]), abs(amplitude[r, c, t, 1]))
        if most * strength[terms[t, HARMONIC]] > least:
            out[count] = t
            count += 1
    return out[:count]
