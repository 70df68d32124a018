"""Where a row of sensor pixels of one plane looks on the panel, and the content there.

Each loop does one thing, so that it vectorises.
"""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu.compiling import jit_in_place
from moireaug.engine.cpu.vectors import (
    content_adding,
    content_weighing,
    load,
    store,
    tap_weights_storing,
)

ROUNDING_OFFSET = 1.5 * 2.0**52  # adding it to a float64 rounds to whole numbers
HALF, ZERO = np.float32(0.5), np.float32(0)
NARROW_TAPS, WIDE_TAPS = 4, 8  # cells along each axis that a pixel's content is taken from
store_narrow_weights, store_wide_weights = map(tap_weights_storing, (NARROW_TAPS, WIDE_TAPS))
narrow_content, wide_content = map(content_weighing, (NARROW_TAPS, WIDE_TAPS))
add_narrow_content, add_wide_content = map(content_adding, (NARROW_TAPS, WIDE_TAPS))


@jit_in_place
def split_into_cells(offset, cell, position, cells, centre):
    """Split panel coordinates (n,) into whole cells, (n,) int32, no farther from the panel than
    `radius` cells around it see, and the offset from there, (n,) float32 in cells.

    position: (n,) float64, panel pixels. cells: their period and the panel's size, in its pixels,
        and the radius. centre: of the cells, panel pixels.
    """
    period, size, radius = cells
    low, high = -radius - 1.0, float((size + period - 1) // period + radius)
    scale = 1 / float(period)
    for i in range(len(position)):
        q = (load(position, i) - centre) * scale
        whole = (q + ROUNDING_OFFSET) - ROUNDING_OFFSET
        store(offset, i, q - whole)
        store(cell, i, np.int32(min(max(whole, low), high)))


@jit_in_place
def locate_taps(first, index, phase_share, offset, nearest, start, phases, taps):
    """Find each pixel's first tap along one axis, and its weights in a table of
    `tap_weights.weight_tables`.

    Args:
        first: (n,) int32, filled with the cell of the first tap. index, phase_share: (n,) int32 and
            float32, filled as in `records.TapWeights`.
        offset, nearest: (n,), from `split_into_cells`. start: (n,) int32, index in the table of the
            left node's weights along this axis. phases, taps: see `records.CoarseGrid`.
    """
    scale, last = np.float32(phases), np.int32(phases - 1)
    size, half = np.int32(taps), np.int32(taps // 2)
    for i in range(len(offset)):
        at = (load(offset, i) + HALF) * scale
        whole = np.int32(min(np.int32(at), last))
        right = np.int32(load(offset, i) >= ZERO)
        store(phase_share, i, at - np.float32(whole))
        store(index, i, np.int32(np.int32(np.int32(whole + right) * size) + load(start, i)))
        store(first, i, np.int32(np.int32(load(nearest, i) + right) - half))


@jit_in_place
def fill_base(base, x, y, stride, origin):
    """Fill base (n,) int32 with the indices of cells (x, y) on the flattened panel."""
    for i in range(len(base)):
        row = np.int32(load(y, i) * stride)
        store(base, i, np.int32(np.int32(row + load(x, i)) + origin))


@jit_in_place
def fill_weights(out, weights, taps):
    """Fill out (n * taps,) float32 with the pixels' tap weights along one axis.

    weights: see `records.TapWeights`.
    """
    if taps == NARROW_TAPS:
        for i in range(len(weights.weight_index)):
            store_narrow_weights(out, weights, i)
    else:
        for i in range(len(weights.weight_index)):
            store_wide_weights(out, weights, i)


@jit_in_place
def content(out, panel, base, stride, weights, weights_y, taps):
    """Fill out (n,) float32 with the weighted content of `taps` x `taps` cells.

    Args:
        panel: flat. base: (n,) int32, index of the first cell. stride: int32, from a row of cells
            to the next.
        weights: along x, see `records.TapWeights`. weights_y: along y, from `fill_weights`.
    """
    if taps == NARROW_TAPS:
        for i in range(len(out)):
            out[i] = narrow_content(panel, base, stride, weights, weights_y, i)
    else:
        for i in range(len(out)):
            out[i] = wide_content(panel, base, stride, weights, weights_y, i)


@jit_in_place
def content_back(panel_grad, grad, base, stride, weights_x, weights_y, taps):
    """Add to panel_grad, flat, the gradient in it from that in the content of pixels (n,); the
    rest as in `content`, with the tap weights along x as those along y."""
    if taps == NARROW_TAPS:
        for i in range(len(grad)):
            add_narrow_content(panel_grad, base, stride, weights_x, weights_y, grad, i)
    else:
        for i in range(len(grad)):
            add_wide_content(panel_grad, base, stride, weights_x, weights_y, grad, i)
