"""The panel's light through the optics as a sum of harmonics, whose amplitudes are cubics over groups of pixels."""

from __future__ import annotations

import numpy as np

from moireaug.engine.compiling import fill, loop
from moireaug.engine.record import LANES
from moireaug.engine.vectors import add_waves

FAINT = 2e-5  # of full scale: what a term must exceed somewhere on the photo
POWERS = 4


@loop
def lagrange(out, t):
    """Fill out (4,) with the weights of values at 0, 1, 2 and 3 in the cubic through them at t."""
    out[0] = -(t - 1) * (t - 2) * (t - 3) / 6
    out[1] = t * (t - 2) * (t - 3) / 2
    out[2] = -t * (t - 1) * (t - 3) / 2
    out[3] = t * (t - 1) * (t - 2) / 6


@loop
def monomials(out, centre, half):
    """Fill out (16,), rows of 4 x 4: the cubic through values at t = 0 to 3, as powers of s, t = centre + half s."""
    at = np.empty((4, 4), np.float64)
    for i in range(4):
        lagrange(at[i], centre + half * (i - 1))
    for j in range(4):
        a, b, c, d = at[0, j], at[1, j], at[2, j], at[3, j]  # the cubic at s = -1, 0, 1, 2
        even, odd = (a + c) / 2 - b, (c - a) / 2
        third = (d - b - 2 * odd - 4 * even) / 6
        out[j], out[4 + j], out[8 + j], out[12 + j] = b, odd - third, even, third


@loop
def trim(amplitude, n, m):
    """Return amplitudes (rows, cols * kinds * n * m) of n = K + 1 and m = 2 L + 1 without the highest k and l, where
    none exceeds FAINT; and the new n and m."""
    rows, half, k_top, l_top = len(amplitude), m // 2, 0, 0
    for r in range(rows):
        row = amplitude[r]
        for i in range(len(row)):
            if abs(row[i]) > FAINT:
                k, l = i // m % n, i % m - half
                k_top, l_top = max(k_top, k), max(l_top, l, -l)
    new_n, new_m = k_top + 1, 2 * l_top + 1
    out = np.empty((rows, amplitude.shape[1] // (n * m) * new_n * new_m), np.float32)
    for r in range(rows):
        for i in range(out.shape[1]):
            place, k, l = i // (new_n * new_m), i // new_m % new_n, i % new_m + half - l_top
            out[r, i] = amplitude[r, (place * n + k) * m + l]
    return out, new_n, new_m


@loop
def fold(amplitude, m):
    """Turn amplitudes (rows, ... * m) of l = -L ... L, m = 2 L + 1, into those of cos(l y) for l = 0 ... L and of
    sin(l y) behind, so that sum_l A_l cos(x + l y) = cos x sum_l B_l cos(l y) + sin x sum_l C_l sin(l y)."""
    half = m // 2
    line = np.empty(m, np.float32)
    for r in range(len(amplitude)):
        row = amplitude[r]
        for start in range(0, len(row), m):
            middle = start + half
            line[0] = row[middle]
            for l in range(1, half + 1):
                line[l] = row[middle + l] + row[middle - l]
                line[half + l] = row[middle - l] - row[middle + l]
            for l in range(m):
                row[start + l] = line[l]


@loop
def cubics(out, row, to_power, start, size):
    """Fill out (POWERS * groups * size,) with the coefficients of s^p from a row of nodes (cols * size,)."""
    groups = len(start)
    for p in range(POWERS):
        for g in range(groups):
            a = start[g] * size
            b, c, d = a + size, a + 2 * size, a + 3 * size
            weight = to_power[g]
            wa, wb, wc, wd = weight[4 * p], weight[4 * p + 1], weight[4 * p + 2], weight[4 * p + 3]
            at = (p * groups + g) * size
            for i in range(size):
                out[at + i] = wa * row[a + i] + wb * row[b + i] + wc * row[c + i] + wd * row[d + i]


@loop
def orders(nodes, groups, kinds, n, m):
    """Return (kinds, 2, n, 2) int64: for powers 0 and 1, and for 2 and 3, and for each k, how many l of cosines and of
    sines count; and how many powers do, 2 or 4.

    nodes: (rows, POWERS * groups * kinds * n * m), as from `cubics`, of k < n and m = 2 L + 1.
    """
    size, half, powers = kinds * n * m, m // 2, 2
    out = np.zeros((kinds, 2, n, 2), np.int64)
    for r in range(len(nodes)):
        row = nodes[r]
        for i in range(len(row)):
            if abs(row[i]) > FAINT:
                pair, term = i // (groups * size) // 2, i % size
                kind, k, l = term // (n * m), term // m % n, term % m
                side, count = (0, l + 1) if l <= half else (1, l - half)
                out[kind, pair, k, side] = max(out[kind, pair, k, side], count)
                powers = max(powers, 2 * pair + 2)
    return out, powers


@loop
def between(out, nodes, base, weights):
    """Fill out with four rows of nodes from `base` on, weighted."""
    a, b, c, d = nodes[base], nodes[base + 1], nodes[base + 2], nodes[base + 3]
    wa, wb, wc, wd = np.float32(weights[0]), np.float32(weights[1]), np.float32(weights[2]), np.float32(weights[3])
    for i in range(len(out)):
        out[i] = wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]


@loop
def _waves_of_x(sums, coefficients, first, stride, power, n, order, cx, ones, every):
    """As `_waves_of_both`, where nothing depends on y."""
    count, groups = 0, n // every
    for k in range(len(order)):
        if order[k, 0]:
            count = k + 1
    start = 2 * power * n
    for a in range(0, n, LANES):
        at = first + (2 * power * groups + a // every) * stride
        add_waves(sums, start + a, start + n + a, ones, 0, coefficients, at, at + groups * stride, count, cx, a, n)


@loop
def _waves_of_both(sums, coefficients, first, stride, power, n, order, cx, sx, cy, sy, every):
    """Add two powers' waves to their rows of `sums`."""
    groups, width = n // every, len(cy) // n
    m = 2 * width - 1
    start = 2 * power * n
    for k in range(len(order)):
        cosines, sines = order[k, 0], order[k, 1]
        for a in range(0, n, LANES):
            at = first + (2 * power * groups + a // every) * stride + k * m
            x = k * n + a
            if cosines:
                to = at + groups * stride
                add_waves(sums, start + a, start + n + a, cx, x, coefficients, at, to, cosines, cy, a, n)
            if sines:
                at += width
                to = at + groups * stride
                add_waves(sums, start + a, start + n + a, sx, x, coefficients, at, to, sines, sy, n + a, n)


@loop
def _add_product(out, content, sums, s, powers):
    n = len(out)
    if powers == 2:
        for i in range(n):
            out[i] += content[i] * (sums[i] + s[i] * sums[n + i])
    else:
        for i in range(n):
            high = sums[2 * n + i] + s[i] * sums[3 * n + i]
            out[i] += content[i] * (sums[i] + s[i] * (sums[n + i] + s[i] * high))


@loop
def transmit(out, content, coefficients, first, stride, powers, order, cx, sx, cy, sy, s, every, sums):
    """Add content (n,) times the light that the cell passes to out (n,); n and `every` are whole numbers of LANES.

    Args:
        coefficients: flat; of power p in group g, (K + 1) (2 L + 1) from first + (p groups + g) stride on.
        powers: 2 or 4. order: (2, K + 1, 2), as from `orders`.
        cx, sx: (K + 1, n), cy, sy: (L + 1, n), as from `waves`, flattened.
        s: (n,), each pixel's place in its group, -1 to 1. sums: (4 n,) to work in.
    """
    n = len(out)
    fill(sums[: powers * n], np.float32(0))
    for power in range(powers // 2):
        if len(cy) == n:
            _waves_of_x(sums, coefficients, first, stride, power, n, order[power], cx, cy, every)
        else:
            _waves_of_both(sums, coefficients, first, stride, power, n, order[power], cx, sx, cy, sy, every)
    _add_product(out, content, sums, s, powers)
