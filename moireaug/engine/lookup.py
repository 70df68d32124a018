"""A row of sensor pixels of one plane: phases, content and waves. Each loop does one thing, so that it vectorises."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import fill, loop
from moireaug.engine.vectors import peek, poke

ROUND = 1.5 * 2.0**52  # adding it rounds to whole numbers
HALF = np.float32(0.5)
UNPACK = np.float32(1 / 65535)
LOW_BITS = np.uint32(0xFFFF)
SIXTEEN = np.uint32(16)
ONE32 = np.int32(1)
# sin and cos of 2 pi d for d in [-1/2, 1/2], by Taylor's series of s(t) = sin(t) and c(t) = cos(t) at t = pi d / 2
S = [np.float32((math.pi / 2) ** (2 * i + 1) * (-1) ** i / math.factorial(2 * i + 1)) for i in range(5)]
C = [np.float32((math.pi / 2) ** (2 * i) * (-1) ** i / math.factorial(2 * i)) for i in range(5)]
S0, S1, S2, S3, S4 = S
C0, C1, C2, C3, C4 = C
ONE, TWO = np.float32(1), np.float32(2)


@loop
def cells(d, n, x, centre, period, low, high):
    """Split panel coordinates x (n,) into whole cells n, int32 between `low` and `high`, and the rest d, float32."""
    scale = 1 / period
    for i in range(len(x)):
        q = (peek(x, i) - centre) * scale
        whole = (q + ROUND) - ROUND
        poke(d, i, q - whole)
        poke(n, i, np.int32(min(max(whole, low), high)))


@loop
def base_of(base, nx, ny, step_x, step_y, start):
    """Fill base (n,) int32 with the indices of cells (nx, ny) on the flattened panel."""
    for i in range(len(base)):
        x, y = np.int32(peek(nx, i) * step_x), np.int32(peek(ny, i) * step_y)
        poke(base, i, np.int32(np.int32(x + y) + start))


@loop
def weigh(before, after, table, d, column, f, phases, offset, to_next):
    """Fill the weights of the cells before and after, by the packed tables (flat) of the two nodes around each pixel.

    column: (n,) int32, where the left node's tables begin, `offset` ahead of this one, and `to_next` ahead of the right
    node's. f: (n,) float32, how far it is to that.
    """
    scale = np.float32(phases)
    last, offset, to_next = np.int32(phases - 1), np.int32(offset), np.int32(to_next)
    for i in range(len(d)):
        at = (peek(d, i) + HALF) * scale
        whole = np.int32(min(np.int32(at), last))
        g = at - np.float32(whole)
        k = np.int32(np.int32(whole + peek(column, i)) + offset)
        ll, lh = peek(table, k), peek(table, np.int32(k + ONE32))
        k = np.int32(k + to_next)
        hl, hh = peek(table, k), peek(table, np.int32(k + ONE32))
        h = peek(f, i)
        a0, a1 = np.float32(np.int32(ll & LOW_BITS)), np.float32(np.int32(lh & LOW_BITS))
        a2, a3 = np.float32(np.int32(hl & LOW_BITS)), np.float32(np.int32(hh & LOW_BITS))
        b0, b1 = np.float32(np.int32(ll >> SIXTEEN)), np.float32(np.int32(lh >> SIXTEEN))
        b2, b3 = np.float32(np.int32(hl >> SIXTEEN)), np.float32(np.int32(hh >> SIXTEEN))
        a0, a2 = a0 + g * (a1 - a0), a2 + g * (a3 - a2)
        b0, b2 = b0 + g * (b1 - b0), b2 + g * (b3 - b2)
        poke(before, i, (a0 + h * (a2 - a0)) * UNPACK)
        poke(after, i, (b0 + h * (b2 - b0)) * UNPACK)


@loop
def _three(panel, j, step, before, here, after):
    """Return a weighted sum of cell j on the flattened panel and its neighbours `step` away."""
    middle = here * peek(panel, j)
    return middle + before * peek(panel, np.int32(j - step)) + after * peek(panel, np.int32(j + step))


@loop
def nine(out, panel, base, wx, wy, step_x, step_y):
    """Fill out (n,) with the content of 3 x 3 cells around `base` on the flattened panel; wx, wy (2, n) are the weights
    of the cells before and after."""
    x0, x1, y0, y1 = wx[0], wx[1], wy[0], wy[1]
    for i in range(len(out)):
        left, right, up, down, j = peek(x0, i), peek(x1, i), peek(y0, i), peek(y1, i), peek(base, i)
        here = ONE - left - right
        above = _three(panel, np.int32(j - step_y), step_x, left, here, right)
        middle = _three(panel, j, step_x, left, here, right)
        below = _three(panel, np.int32(j + step_y), step_x, left, here, right)
        poke(out, i, up * above + (ONE - up - down) * middle + down * below)


@loop
def _five(panel, j, step, far_before, before, here, after, far_after):
    """As `_three`, of two neighbours to each side."""
    two = np.int32(step + step)
    far = far_before * peek(panel, np.int32(j - two)) + far_after * peek(panel, np.int32(j + two))
    return far + _three(panel, j, step, before, here, after)


@loop
def twenty_five(out, panel, base, wx, wy, step_x, step_y):
    """As `nine`, of 5 x 5 cells; wx and wy (4, n)."""
    x0, x1, x2, x3, y0, y1, y2, y3 = wx[0], wx[1], wx[2], wx[3], wy[0], wy[1], wy[2], wy[3]
    two = np.int32(step_y + step_y)
    for i in range(len(out)):
        b, a, bb, aa, j = peek(x0, i), peek(x1, i), peek(x2, i), peek(x3, i), peek(base, i)
        h = ONE - a - b - aa - bb
        up, down, far_up, far_down = peek(y0, i), peek(y1, i), peek(y2, i), peek(y3, i)
        total = (ONE - up - down - far_up - far_down) * _five(panel, j, step_x, bb, b, h, a, aa)
        total += up * _five(panel, np.int32(j - step_y), step_x, bb, b, h, a, aa)
        total += down * _five(panel, np.int32(j + step_y), step_x, bb, b, h, a, aa)
        total += far_up * _five(panel, np.int32(j - two), step_x, bb, b, h, a, aa)
        total += far_down * _five(panel, np.int32(j + two), step_x, bb, b, h, a, aa)
        poke(out, i, total)


@loop
def _add_tap(out, panel, base, weight, step):
    for i in range(len(out)):
        poke(out, i, out[i] + peek(weight, i) * peek(panel, np.int32(peek(base, i) + step)))


@loop
def _rest(out, weights):
    """Fill out with what weights (m, n) leave of 1."""
    fill(out, ONE)
    for j in range(len(weights)):
        row = weights[j]
        for i in range(len(out)):
            out[i] -= row[i]


@loop
def _cell_of(j):
    """Return the cell whose weight is row j of the tables; -1 stands for the middle one."""
    return 0 if j < 0 else (j // 2 + 1) * (2 * (j % 2) - 1)


@loop
def many(out, panel, base, wx, wy, step_x, step_y, line):
    """As `nine`, of (2 r + 1)^2 cells, a tap at a time; wx and wy (2 r, n), `line` (n,) to work in."""
    n = len(out)
    rest_x, rest_y = np.empty(n, np.float32), np.empty(n, np.float32)
    _rest(rest_x, wx)
    _rest(rest_y, wy)
    fill(out, np.float32(0))
    for j in range(-1, len(wy)):
        fill(line, np.float32(0))
        for k in range(-1, len(wx)):
            step = np.int32(_cell_of(j) * step_y + _cell_of(k) * step_x)
            _add_tap(line, panel, base, rest_x if k < 0 else wx[k], step)
        row = rest_y if j < 0 else wy[j]
        for i in range(n):
            out[i] += row[i] * line[i]


@loop
def _first_wave(cos, sin, d):
    for i in range(len(d)):
        t = peek(d, i)
        t2 = t * t
        # at a quarter of the angle, then doubled twice
        s = t * (S0 + t2 * (S1 + t2 * (S2 + t2 * (S3 + t2 * S4))))
        c = C0 + t2 * (C1 + t2 * (C2 + t2 * (C3 + t2 * C4)))
        s, c = TWO * s * c, ONE - TWO * s * s
        poke(sin, i, TWO * s * c)
        poke(cos, i, ONE - TWO * s * s)


@loop
def _next_wave(out, first, last, before):
    for i in range(len(out)):
        poke(out, i, TWO * peek(first, i) * peek(last, i) - peek(before, i))


@loop
def waves(cos, sin, d, count, sines):
    """Fill cos and, if `sines`, sin (count * n,) with cos and sin of 2 pi k d (n,), k < count, d in [-1/2, 1/2]; k = 0
    is there already."""
    n = len(d)
    if count > 1:
        _first_wave(cos[n : 2 * n], sin[n : 2 * n], d)
    for k in range(2, count):
        a, b, c = (k - 2) * n, (k - 1) * n, k * n
        _next_wave(cos[c : c + n], cos[n : 2 * n], cos[b : b + n], cos[a : a + n])
        if sines:
            _next_wave(sin[c : c + n], cos[n : 2 * n], sin[b : b + n], sin[a : a + n])
