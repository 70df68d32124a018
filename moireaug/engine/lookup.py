"""A row of sensor pixels of one plane: where they look on the panel, and the content there.

Each loop does one thing, so that it vectorises.
"""

from __future__ import annotations

import numpy as np

from moireaug.engine.compiling import inner
from moireaug.engine.vectors import (
    eight_by_eight,
    eight_by_six,
    eight_weights,
    four_by_four,
    four_weights,
    peek,
    poke,
)

ROUND = 1.5 * 2.0**52  # adding it rounds to whole numbers
HALF, ZERO = np.float32(0.5), np.float32(0)
NARROW, WIDE = 4, 8  # cells along each axis that a pixel's content is taken from
SIX_ROWS = 2  # up to so many taps, the outermost two of WIDE rows have no light


@inner
def cells(d, n, x, centre, period, low, high):
    """Split panel coordinates x (n,) into whole cells n, int32 between `low` and `high`, and the
    remainder d, float32 in cells."""
    scale = 1 / period
    for i in range(len(x)):
        q = (peek(x, i) - centre) * scale
        whole = (q + ROUND) - ROUND
        poke(d, i, q - whole)
        poke(n, i, np.int32(min(max(whole, low), high)))


@inner
def windows(start, place, between, d, n, column, phases, width):
    """Find the first of the `width` cells around each pixel, and their weights in the table of
    `weights.weights`.

    Args:
        start: (n,) int32, filled with the cell. place: (n,) int32, filled with where in the table
            the weights of the phase before are; between: (n,) float32, filled with how far the
            pixel is towards the next phase.
        d, n: from `cells`. column: (n,) int32, where the left node's weights along this axis begin.
    """
    scale, last = np.float32(phases), np.int32(phases - 1)
    size, half = np.int32(width), np.int32(width // 2)
    for i in range(len(d)):
        at = (peek(d, i) + HALF) * scale
        whole = np.int32(min(np.int32(at), last))
        right = np.int32(peek(d, i) >= ZERO)
        poke(between, i, at - np.float32(whole))
        poke(place, i, np.int32(np.int32(np.int32(whole + right) * size) + peek(column, i)))
        poke(start, i, np.int32(np.int32(peek(n, i) + right) - half))


@inner
def base_of(base, x, y, stride, origin):
    """Fill base (n,) int32 with the places of cells (x, y) on the flattened panel."""
    for i in range(len(base)):
        row = np.int32(peek(y, i) * stride)
        poke(base, i, np.int32(np.int32(row + peek(x, i)) + origin))


@inner
def down(out, table, to_next, place, between, share, width):
    """Fill out (n * width,) with the weights of each pixel's `width` rows of cells.

    Args:
        table: flat, of one kind, from `weights.weights`. to_next: int32, from a node's weights to
            the next node's.
        place, between: (n,), from `windows`. share: (n,) float32, how far the pixel is towards the
            next node.
    """
    if width == NARROW:
        four_weights(out, table, to_next, place, between, share)
    else:
        eight_weights(out, table, to_next, place, between, share)


@inner
def content(out, panel, base, stride, table, to_next, place, between, share, rows, width, taps):
    """Fill out (n,) with the content of `width` x `width` cells, weighted.

    Args:
        panel: flat. base: (n,) int32, the first cell. stride: int32, from a row of cells to the
            next.
        table, to_next, place, between, share: of the columns of cells, as in `down`.
        rows: the weights of the rows of cells, from `down`.
        taps: cells to each side of the nearest one that give light.
    """
    if width == NARROW:
        four_by_four(out, panel, base, stride, table, to_next, place, between, share, rows)
    elif taps <= SIX_ROWS:
        eight_by_six(out, panel, base, stride, table, to_next, place, between, share, rows)
    else:
        eight_by_eight(out, panel, base, stride, table, to_next, place, between, share, rows)
