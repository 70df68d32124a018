"""The panel's light through the optics as a sum of harmonics, whose amplitudes change slowly over
the photo.

A term is a kind of subpixel, a pair (k, l) and whether it is the sine one: cos(k x) cos(l y), or
with SINE sin(k x) sin(l y).
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.cpu.compiling import fill, jit, jit_in_place
from moireaug.engine.cpu.vectors import load, store

KIND, K, L, SINE = 0, 1, 2, 3
ONE, TWO, ZERO = np.float32(1), np.float32(2), np.float32(0)
# sin and cos of 2 pi d for d in [-1/2, 1/2], by Taylor's series of s(t) = sin(t) and c(t) = cos(t)
# at t = pi d / 2
SIN_SERIES = [
    np.float32((math.pi / 2) ** (2 * i + 1) * (-1) ** i / math.factorial(2 * i + 1))
    for i in range(5)
]
COS_SERIES = [
    np.float32((math.pi / 2) ** (2 * i) * (-1) ** i / math.factorial(2 * i)) for i in range(5)
]
S0, S1, S2, S3, S4 = SIN_SERIES
C0, C1, C2, C3, C4 = COS_SERIES


@jit_in_place
def cubic_weights(t):
    """Return the weights of values at 0, 1, 2 and 3 in the cubic through them at t, float64."""
    a, b, c, d = t, t - 1, t - 2, t - 3
    return -b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6


@jit_in_place
def cubic_weights32(t):
    """Return `cubic_weights` as float32."""
    a, b, c, d = cubic_weights(t)
    return np.float32(a), np.float32(b), np.float32(c), np.float32(d)


@jit
def fold(amplitude):
    """Turn amplitudes (..., m) of l = -L ... L, m = 2 L + 1, into those of cos(l y) for l = 0 ... L
    followed by those of sin(l y), so that sum_l A_l cos(k x + l y) = cos(k x) sum_l B_l cos(l y) +
    sin(k x) sum_l C_l sin(l y)."""
    m = amplitude.shape[-1]
    half, rows = m // 2, amplitude.reshape(-1, m)
    line = np.empty(m, np.float32)
    for r in range(len(rows)):
        line[0] = rows[r, half]
        for l in range(1, half + 1):
            line[l] = rows[r, half + l] + rows[r, half - l]
            line[half + l] = rows[r, half - l] - rows[r, half + l]
        for l in range(m):
            rows[r, l] = line[l]


@jit
def harmonic_terms(amplitude, least):
    """Return the terms (T, 4) int64 that exceed `least` at any node, in order, of folded amplitudes
    (rows, cols, kinds, n, m)."""
    rows, cols, kinds, n, m = amplitude.shape
    half = m // 2
    out, count = np.empty((kinds * n * m, 4), np.int64), 0
    for kind in range(kinds):
        for k in range(n):
            for l in range(m):
                most = ZERO
                for r in range(rows):
                    for c in range(cols):
                        most = max(most, abs(amplitude[r, c, kind, k, l]))
                sine = l > half
                if most > least and not (sine and k == 0):  # sin(0 x) is 0
                    out[count, KIND], out[count, K] = kind, k
                    out[count, L], out[count, SINE] = l - half if sine else l, 1 if sine else 0
                    count += 1
    return out[:count]


@jit_in_place
def interpolate_line(line, values, ends, weight):
    """Fill a line of n pixels with values at nodes (cols,), interpolated.

    Args:
        ends: (cols - 2,) int64, of the pixels on the cubics through nodes 0 to 3, 1 to 4, and so
            on: the first pixel of each, and n. weight: (4, n) float32, of the cubics' nodes.
    """
    for j in range(len(ends) - 1):
        low, high = ends[j], ends[j + 1]
        out, a, b, c, d = line[low:high], values[j], values[j + 1], values[j + 2], values[j + 3]
        first, second = weight[0, low:high], weight[1, low:high]
        third, fourth = weight[2, low:high], weight[3, low:high]
        for i in range(len(out)):
            left = a * load(first, i) + b * load(second, i)
            store(out, i, left + (c * load(third, i) + d * load(fourth, i)))


@jit_in_place
def interpolate_to_pixels(out, amplitude, terms, ends, weight):
    """Fill out (rows, T * n) float32 with each term's amplitude at n pixels of each row of nodes.

    Args:
        amplitude: folded, at nodes (rows, cols, kinds, K + 1, 2 L + 1).
        terms: from `harmonic_terms`. ends, weight: as in `interpolate_line`.
    """
    n, half = weight.shape[1], amplitude.shape[4] // 2
    for r in range(len(amplitude)):
        for t in range(len(terms)):
            kind, k = terms[t, KIND], terms[t, K]
            l = terms[t, L] + half * terms[t, SINE]
            line, values = out[r, t * n : (t + 1) * n], amplitude[r, :, kind, k, l]
            interpolate_line(line, values, ends, weight)


@jit_in_place
def fill_fundamental(cos, sin, d):
    """Fill cos and sin (n,) with cos and sin of 2 pi d, d (n,) in [-1/2, 1/2]."""
    for i in range(len(d)):
        t = load(d, i)
        t2 = t * t
        # at a quarter of the angle, then doubled twice
        s = t * (S0 + t2 * (S1 + t2 * (S2 + t2 * (S3 + t2 * S4))))
        c = C0 + t2 * (C1 + t2 * (C2 + t2 * (C3 + t2 * C4)))
        s, c = TWO * s * c, ONE - TWO * s * s
        store(sin, i, TWO * s * c)
        store(cos, i, ONE - TWO * s * s)


@jit_in_place
def _next_wave(out, first, last, before):
    # last and before were stored here, for lower k
    for i in range(len(out)):
        store(out, i, TWO * load(first, i) * last[i] - before[i])


@jit_in_place
def fill_waves(cos, sin, d):
    """Fill cos and sin (count, n) with cos and sin of 2 pi k d, d (n,) in [-1/2, 1/2]; k = 0 is
    there already."""
    if len(cos) > 1:
        fill_fundamental(cos[1], sin[1], d)
    for k in range(2, len(cos)):
        _next_wave(cos[k], cos[1], cos[k - 1], cos[k - 2])
        _next_wave(sin[k], cos[1], sin[k - 1], sin[k - 2])


@jit_in_place
def _add(out, first, second, third, fourth, weight, wave):
    """Add a wave (n,) to out (n,), times its amplitude, weighted from four rows of nodes."""
    wa, wb, wc, wd = weight
    for i in range(len(out)):
        amplitude = wa * load(first, i) + wb * load(second, i)
        amplitude += wc * load(third, i) + wd * load(fourth, i)
        store(out, i, out[i] + amplitude * load(wave, i))


@jit_in_place
def row_amplitudes(even, odd, terms, kind, lines, weight, cos_y, sin_y):
    """Fill even and odd (K + 1, n) with the amplitudes of cos(k x) and sin(k x) on a row, of one
    kind of subpixel.

    Args:
        lines: (4, T * n), each term's amplitude on four rows of nodes. weight: of the four, from
            `cubic_weights32`.
        cos_y, sin_y: (L + 1, n), from `fill_waves`.
    """
    n = even.shape[1]
    fill(even.reshape(-1), ZERO)
    fill(odd.reshape(-1), ZERO)
    for i in range(len(terms)):
        if terms[i, KIND] != kind:
            continue
        k, l, a, b = terms[i, K], terms[i, L], i * n, (i + 1) * n
        first, second, third, fourth = lines[0, a:b], lines[1, a:b], lines[2, a:b], lines[3, a:b]
        if terms[i, SINE]:
            _add(odd[k], first, second, third, fourth, weight, sin_y[l])
        else:
            _add(even[k], first, second, third, fourth, weight, cos_y[l])


@jit_in_place
def _rotate_phase(in_phase, quadrature, even, odd, cos, sin):
    for i in range(len(in_phase)):
        e, o, c, s = load(even, i), load(odd, i), load(cos, i), load(sin, i)
        store(in_phase, i, e * c + o * s)
        store(quadrature, i, e * s - o * c)


@jit_in_place
def rotate_phase(in_phase, quadrature, even, odd, cos_x, sin_x):
    """Fill in_phase and quadrature (K + 1, n) with the harmonics at the pixels, and with the same
    shifted by a quarter of a period.

    even, odd: from `row_amplitudes`. cos_x, sin_x: (K + 1, n), from `fill_waves`.
    """
    for k in range(len(in_phase)):
        _rotate_phase(in_phase[k], quadrature[k], even[k], odd[k], cos_x[k], sin_x[k])


@jit_in_place
def _add_shifted(out, in_phase, quadrature, cos, sin):
    for i in range(len(out)):
        store(out, i, out[i] + cos * load(in_phase, i) + sin * load(quadrature, i))


@jit_in_place
def fill_modulation(modulation, in_phase, quadrature, cos, sin):
    """Fill modulation (n,) with the sum of one subpixel's harmonics.

    Args:
        in_phase, quadrature: from `rotate_phase`. cos, sin: (K + 1,) float32, of k times the angle
            of the subpixel's centre in the cell.
    """
    fill(modulation, ZERO)
    for k in range(len(in_phase)):
        _add_shifted(modulation, in_phase[k], quadrature[k], cos[k], sin[k])


@jit_in_place
def add_product(out, first, second):
    """Add the product of two rows to out, (n,) each."""
    for i in range(len(out)):
        store(out, i, out[i] + load(first, i) * load(second, i))
