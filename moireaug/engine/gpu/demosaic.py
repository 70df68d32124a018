"""The colours of a sensor pixel from packed readings, and the gradient on the way back.

Readings of three planes are colours already. Those of four are R, G, G, B: of bins, whose greens
are averaged, or, where there are taps, of 2 x 2 sensor pixels, whose other colours a linear
demosaic takes from the pixels around them.
`variant` is a `develop_arrays.CodesVariant`.
"""

from __future__ import annotations

import functools

import numpy as np
import triton
import triton.language as tl

from moireaug.engine.gpu.tile import Pixels, address, black, tile, tile_corner

ROUNDING_OFFSET = tl.constexpr(1.5 * 2**23)  # adding it to a float32 rounds to whole numbers

# rows below and columns to the right of a pixel, and of each colour its weights at the four sites
Tap = tuple[int, int, tuple[tuple[float, ...], ...]]


def taps_of(weight: np.ndarray) -> tuple[Tap, ...]:
    """Return a demosaic's taps, for kernels to be compiled with.

    Args:
        weight: see `development_records.Codes.demosaic`.
    """
    return _taps(weight.tobytes())


@functools.lru_cache(maxsize=8)
def _taps(data: bytes) -> tuple[Tap, ...]:
    weight = np.frombuffer(data, np.float32).reshape(4, 3, 2, 2, 3, 3)
    of_offset: dict[tuple[int, int], np.ndarray] = {}
    for index in np.argwhere(weight):
        site, colour, plane_row, plane_col, cell_row, cell_col = map(int, index)
        down = 2 * (cell_row - 1) + plane_row - site // 2
        right = 2 * (cell_col - 1) + plane_col - site % 2
        of_sites = of_offset.setdefault((down, right), np.zeros((3, 4)))
        of_sites[colour, site] = weight[tuple(index)]
    taps = []
    for offset in sorted(of_offset):
        of_colours = [tuple(row) if any(row) else () for row in of_offset[offset].tolist()]
        taps.append((*offset, tuple(of_colours)))
    return tuple(taps)


@triton.jit
def packed_reading(raw, plane, pixels, variant: tl.constexpr):
    """Return readings of a plane: saturated, and rounded as by the converter."""
    at = address(raw, pixels, variant.planes) + plane * raw.height * raw.width
    value = tl.load(at, mask=pixels.exist, other=0.0)
    if variant.saturates:
        value = tl.minimum(value, 1.0)
    if variant.levels > 0:
        steps = tl.minimum(tl.maximum(value, 0.0), 1.0) * variant.levels
        value = ((steps + ROUNDING_OFFSET) - ROUNDING_OFFSET) / variant.levels
    return value


@triton.jit
def store_reading_grad(raw_grad, raw, plane, pixels, grad, variant: tl.constexpr):
    """Store the gradient in readings of a plane, from that in `packed_reading`."""
    offset = plane * raw.height * raw.width
    if variant.saturates:
        value = tl.load(address(raw, pixels, variant.planes) + offset, mask=pixels.exist, other=0.0)
        grad = tl.where(value <= 1.0, grad, 0.0)
    tl.store(address(raw_grad, pixels, variant.planes) + offset, grad, mask=pixels.exist)


@triton.jit
def at_site(weight: tl.constexpr, odd_row, odd_col):
    """Return one colour's weight, of those of four sites, at sensor pixels."""
    return tl.where(
        odd_row,
        tl.where(odd_col, weight[3], weight[2]),
        tl.where(odd_col, weight[1], weight[0]),
    )


@triton.jit
def sensor_colours(raw, pixels, variant: tl.constexpr):
    """Return red, green and blue light of Pixels of the sensor. Past the border, the outermost
    cells are repeated."""
    if len(variant.taps) == 0:
        green = packed_reading(raw, 1, pixels, variant)
        if variant.planes == 4:
            green = 0.5 * (green + packed_reading(raw, 2, pixels, variant))
        red = packed_reading(raw, 0, pixels, variant)
        return red, green, packed_reading(raw, variant.planes - 1, pixels, variant)
    odd_row, odd_col, colours = pixels.row % 2 == 1, pixels.col % 2 == 1, black(pixels.exist)
    for k in tl.static_range(len(variant.taps)):
        y, x = pixels.row + variant.taps[k][0], pixels.col + variant.taps[k][1]
        cell_row = tl.minimum(tl.maximum(y >> 1, 0), raw.height - 1)
        cell_col = tl.minimum(tl.maximum(x >> 1, 0), raw.width - 1)
        cell = Pixels(pixels.image, cell_row, cell_col, pixels.exist)
        value, total = packed_reading(raw, (y & 1) * 2 + (x & 1), cell, variant), ()
        for colour in tl.static_range(3):
            weight = variant.taps[k][2][colour]
            if len(weight) > 0:
                total = total + (colours[colour] + at_site(weight, odd_row, odd_col) * value,)
            else:
                total = total + (colours[colour],)
        colours = total
    return colours


@triton.jit
def mosaic_grad(light_grad, pixels, variant: tl.constexpr):
    """Return the gradient in Pixels of the mosaic, which may lie past the border, from that in the
    light of every sensor pixel."""
    total = tl.full(pixels.exist.shape, 0.0, tl.float32)
    for k in tl.static_range(len(variant.taps)):
        y, x = pixels.row - variant.taps[k][0], pixels.col - variant.taps[k][1]
        exist = pixels.exist & (y >= 0) & (y < light_grad.height)
        exist = exist & (x >= 0) & (x < light_grad.width)
        at = address(light_grad, Pixels(pixels.image, y, x, exist), 3)
        for colour in tl.static_range(3):
            weight = variant.taps[k][2][colour]
            if len(weight) > 0:
                plane = colour * light_grad.height * light_grad.width
                value = tl.load(at + plane, mask=exist, other=0.0)
                total += at_site(weight, y % 2 == 1, x % 2 == 1) * value
    return total


@triton.jit
def max_copies(first, count, end):
    """Return at how many places the demosaic reads a cell of a row (or column) of `end`, at most,
    for `count` cells from `first` on. The outermost are repeated past the border."""
    outermost = (first == 0) | (first + count >= end)
    return 1 + tl.where(outermost, 1, 0) + tl.where(end == 1, 1, 0)


@triton.jit
def copy_of(cell, k, end):
    """Return the k-th place at which the demosaic reads cells of a row (or column), and whether
    there is one: their own, and that beside the first or the last."""
    beside = tl.where((cell == 0) & (k == 1), -1, end)
    outermost = (cell == 0) | (cell == end - 1)
    exists = (k == 0) | ((k == 1) & outermost) | ((k == 2) & (end == 1))
    return tl.where(k == 0, cell, beside), exists


@triton.jit
def demosaic_back_kernel(raw_grad, light_grad, raw, variant: tl.constexpr, TILE: tl.constexpr):
    """Fill raw_grad (B, 4, h, w) from light_grad (B, 3, 2 h, 2 w), of every sensor pixel."""
    cells, (_, first_row, first_col) = tile(raw, TILE), tile_corner(raw, TILE)
    row_copies = max_copies(first_row, TILE[0], raw.height)
    col_copies = max_copies(first_col, TILE[1], raw.width)
    for plane in range(4):
        total = tl.full(cells.exist.shape, 0.0, tl.float32)
        for i in range(row_copies):
            y, row_exists = copy_of(cells.row, i, raw.height)
            for j in range(col_copies):
                x, col_exists = copy_of(cells.col, j, raw.width)
                exist = cells.exist & row_exists & col_exists
                site = Pixels(cells.image, 2 * y + plane // 2, 2 * x + plane % 2, exist)
                total += mosaic_grad(light_grad, site, variant)
        store_reading_grad(raw_grad, raw, plane, cells, total, variant)
