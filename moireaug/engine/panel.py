"""The picture as the panel shows it: resampled to panel pixels once, with a margin so that no
look-up leaves it."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import inner, part
from moireaug.engine.vectors import peek, poke

AROUND = 5  # cells of margin beyond the cell's `radius`: half of the widest window, and one


@inner
def shape(size, alpha, cell):
    """Return the height and width of the panel's picture with its margins, whole cells of every
    kind."""
    around, px, py = 2 * (cell.radius + AROUND), cell.whole[0], cell.whole[1]
    return (math.ceil(alpha * size[0] / py) + around) * py, (
        math.ceil(alpha * size[1] / px) + around
    ) * px


@inner
def margin(cell, axis):
    """Return how many panel pixels of margin lie ahead of the picture."""
    return (cell.radius + AROUND) * cell.whole[axis]


@inner
def _period_of(cell, channel):
    """Return the period along x of a channel's subpixels, which share one."""
    for i in range(len(cell.channel)):
        if cell.channel[i] == channel:
            return cell.period[cell.kind[i], 0]
    return 1


@inner
def _axis(n, size, alpha, period, lead, first, share, seen):
    """Find where each of n panel pixels lies between two picture pixels, and whether it is on the
    picture.

    period: of the cells whose first pixels are stored as neighbours, then their second, and so on.
    lead: panel pixels ahead of the picture.
    """
    cells = n // period
    for i in range(n):
        pixel = i % cells * period + i // cells
        at = (pixel - lead + 0.5) / alpha
        seen[i] = 0 <= at < size
        at = min(max(at - 0.5, 0.0), size - 1.0)
        first[i] = np.int32(at)
        share[i] = at - first[i]


@inner
def _between(out, first, second, f):
    """Fill out (w + 1,) with a row interpolated between two (w,), its last pixel repeated."""
    w = len(first)
    for i in range(w):
        out[i] = first[i] + f * (second[i] - first[i])
    out[w] = out[w - 1]


@inner
def _across(out, row, first, share):
    for i in range(len(out)):
        x = peek(first, i)
        low = peek(row, x)
        poke(out, i, low + peek(share, i) * (peek(row, np.int32(x + np.int32(1))) - low))


@part
def show(panel, light, alpha, cell, dark):
    """Fill panel (3, h, w) float32, of `shape`, from the picture's light (3, H, W) float32.

    A row holds the first pixel of each of its colour's cells, then the second, and so on, so that
    look-ups read contiguous memory. Bilinear between pixel centres; beyond the border the outermost
    pixel or, if `dark`, black.
    """
    (h, w), (_, n, m) = light.shape[1:], panel.shape
    x, fx, seen_x = np.empty(m, np.int32), np.empty(m, np.float32), np.empty(m, np.bool_)
    y, fy, seen_y = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.bool_)
    _axis(n, h, alpha, 1, margin(cell, 1), y, fy, seen_y)
    row = np.empty(w + 1, np.float32)
    for c in range(3):
        _axis(m, w, alpha, _period_of(cell, c), margin(cell, 0), x, fx, seen_x)
        for i in range(n):
            low = np.int64(y[i])
            _between(row, light[c, low], light[c, min(low + 1, h - 1)], fy[i])
            _across(panel[c, i], row, x, fx)
            if dark:
                for j in range(m):
                    if not (seen_y[i] and seen_x[j]):
                        panel[c, i, j] = 0
