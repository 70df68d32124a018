"""The colours of a sensor pixel from packed readings, and the gradient on the way back.

Readings of three planes are colours already. Those of four are the colour filters of a cell, R, G,
G, B: of 2 x 2 sensor pixels, whose other colours a linear demosaic takes from the pixels around
them, or of one binned pixel, whose greens are averaged.
"""

from __future__ import annotations

import functools

import numpy as np
import triton
import triton.language as tl

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
def reading(raw, plane, row, col, size, exists, SATURATES: tl.constexpr, LEVELS: tl.constexpr):
    """Return readings of an image's planes: saturated, and rounded as by the converter."""
    value = tl.load(raw + (plane * size[0] + row) * size[1] + col, mask=exists, other=0.0)
    if SATURATES:
        value = tl.minimum(value, 1.0)
    if LEVELS > 0:
        steps = tl.minimum(tl.maximum(value, 0.0), 1.0) * LEVELS
        value = ((steps + ROUNDING_OFFSET) - ROUNDING_OFFSET) / LEVELS
    return value


@triton.jit
def at_site(weight: tl.constexpr, odd_row, odd_col):
    """Return one colour's weight, of those of four sites, at sensor pixels."""
    return tl.where(
        odd_row,
        tl.where(odd_col, weight[3], weight[2]),
        tl.where(odd_col, weight[1], weight[0]),
    )


@triton.jit
def _demosaiced(raw, row, col, size, exists, TAPS: tl.constexpr, SATURATES, LEVELS):
    """Return the colours of sensor pixels. Past the border, the outermost cells are repeated."""
    odd_row, odd_col = row % 2 == 1, col % 2 == 1
    red = tl.full(exists.shape, 0.0, tl.float32)
    green = tl.full(exists.shape, 0.0, tl.float32)
    blue = tl.full(exists.shape, 0.0, tl.float32)
    for k in tl.static_range(len(TAPS)):
        y = row + TAPS[k][0]
        x = col + TAPS[k][1]
        plane = (y & 1) * 2 + (x & 1)
        cell_row = tl.minimum(tl.maximum(y >> 1, 0), size[0] - 1)
        cell_col = tl.minimum(tl.maximum(x >> 1, 0), size[1] - 1)
        value = reading(raw, plane, cell_row, cell_col, size, exists, SATURATES, LEVELS)
        if len(TAPS[k][2][0]) > 0:
            red += at_site(TAPS[k][2][0], odd_row, odd_col) * value
        if len(TAPS[k][2][1]) > 0:
            green += at_site(TAPS[k][2][1], odd_row, odd_col) * value
        if len(TAPS[k][2][2]) > 0:
            blue += at_site(TAPS[k][2][2], odd_row, odd_col) * value
    return red, green, blue


@triton.jit
def colours(
    raw,
    row,
    col,
    size,
    exists,
    PLANES: tl.constexpr,
    TAPS: tl.constexpr,
    SATURATES: tl.constexpr,
    LEVELS: tl.constexpr,
):
    """Return red, green and blue light of the sensor pixels at rows and columns of an image.

    Args:
        raw: the image's planes. size: their height and width.
        TAPS: of a demosaic, or empty where each pixel of the planes is one of the photo.
        SATURATES, LEVELS: see `development_records.Codes`.
    """
    if len(TAPS) > 0:
        red, green, blue = _demosaiced(raw, row, col, size, exists, TAPS, SATURATES, LEVELS)
    else:
        red = reading(raw, 0, row, col, size, exists, SATURATES, LEVELS)
        green = reading(raw, 1, row, col, size, exists, SATURATES, LEVELS)
        blue = reading(raw, PLANES - 1, row, col, size, exists, SATURATES, LEVELS)
        if PLANES == 4:
            green = (green + reading(raw, 2, row, col, size, exists, SATURATES, LEVELS)) * 0.5
    return red, green, blue


@triton.jit
def demosaic_back(grad, row, col, height, width, exists, TAPS: tl.constexpr):
    """Return the gradient in pixels of the mosaic, which may lie past the border, from that in the
    colours, planes (3, height, width), of the sensor's pixels."""
    total = tl.full(exists.shape, 0.0, tl.float32)
    for k in tl.static_range(len(TAPS)):
        y = row - TAPS[k][0]
        x = col - TAPS[k][1]
        there = exists & (y >= 0) & (y < height) & (x >= 0) & (x < width)
        at = grad + y * width + x
        for colour in tl.static_range(3):
            if len(TAPS[k][2][colour]) > 0:
                value = tl.load(at + colour * height * width, mask=there, other=0.0)
                total += at_site(TAPS[k][2][colour], y % 2 == 1, x % 2 == 1) * value
    return total
