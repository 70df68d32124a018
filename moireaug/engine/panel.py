"""The picture as the panel shows it: resampled to panel pixels once, with a margin so that no look-up leaves it."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import fill, kernel, loop
from moireaug.engine.tables import DECODE_BYTES, decode
from moireaug.engine.vectors import peek, poke


def panel_shape(size: tuple[int, int], alpha: float, period: tuple[int, int], taps: int) -> tuple[int, int]:
    """Return the height and width of the panel's picture with its margins."""
    (h, w), (px, py) = size, period
    return math.ceil(alpha * h) + (4 * taps + 3) * py, math.ceil(alpha * w) + (4 * taps + 3) * px


@loop
def margin(period, taps):
    """Return the panel pixels ahead of the panel's first."""
    return (2 * taps + 1) * period


@loop
def _axis(n, size, alpha, lead, first, share, seen):
    """Where each of n panel pixels lies between two picture pixels, and whether it is on the picture."""
    for i in range(n):
        at = (i - lead + 0.5) / alpha
        seen[i] = 0 <= at < size
        at = min(max(at - 0.5, 0.0), size - 1.0)
        first[i] = np.int32(at)
        share[i] = at - first[i]


@loop
def _row(out, picture, byte, coded):
    """Bring a row of the picture to light; its last pixel twice."""
    w = len(picture)
    if byte and coded:
        for i in range(w):
            out[i] = DECODE_BYTES[np.uint32(picture[i])]
    elif byte:
        for i in range(w):
            out[i] = np.float32(picture[i]) * np.float32(1 / 255)
    elif coded:
        for i in range(w):
            out[i] = decode(np.float32(picture[i]))
    else:
        for i in range(w):
            out[i] = picture[i]
    out[w] = out[w - 1]


@loop
def _between(out, first, second, f):
    for i in range(len(out)):
        out[i] = first[i] + f * (second[i] - first[i])


@loop
def _across(out, row, first, share):
    for i in range(len(out)):
        x = peek(first, i)
        low = peek(row, x)
        poke(out, i, low + peek(share, i) * (peek(row, np.int32(x + np.int32(1))) - low))


@kernel
def show(panel, picture, alpha, period, taps, coded, dark):
    """Fill panel (3, h, w) float32, of `panel_shape`, from picture (3, H, W) float32 or uint8.

    Bilinear between pixel centres; beyond the border the outermost pixel or, if `dark`, black.

    Args:
        coded: the picture holds sRGB codes, the panel shows light.
    """
    (h, w), (_, n, m) = picture.shape[1:], panel.shape
    byte = picture.itemsize == 1
    x, fx, seen_x = np.empty(m, np.int32), np.empty(m, np.float32), np.empty(m, np.bool_)
    y, fy, seen_y = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.bool_)
    _axis(m, w, alpha, margin(period[0], taps), x, fx, seen_x)
    _axis(n, h, alpha, margin(period[1], taps), y, fy, seen_y)
    rows, row, held = np.empty((2, w + 1), np.float32), np.empty(w + 1, np.float32), np.empty(2, np.int64)
    for c in range(3):
        fill(held, -1)
        for i in range(n):
            low = np.int64(y[i])
            high = min(low + 1, h - 1)
            for k in range(2):
                at = high if k else low
                if held[at % 2] != at:
                    _row(rows[at % 2], picture[c, at], byte, coded)
                    held[at % 2] = at
            _between(row, rows[low % 2], rows[high % 2], fy[i])
            _across(panel[c, i], row, x, fx)
            if dark:
                for j in range(m):
                    if not (seen_y[i] and seen_x[j]):
                        panel[c, i, j] = 0
