"""A linear resize along both axes, and the gradient on the way back. `rows` and `cols` are each a
`develop_arrays.ResizeArrays`."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def first_pixel(axis, at, size):
    """Return the first sensor pixel, along one axis, that photo pixels are made from."""
    return tl.load(axis.start + at, mask=at < size, other=0)


@triton.jit
def tap_weight(axis, at, tap, size):
    """Return how much the tap-th sensor pixel from the first on weighs in photo pixels."""
    return tl.load(axis.taps + at * axis.tap_count + tap, mask=at < size, other=0.0)


@triton.jit
def weight_in(axis, at, pixel, there):
    """Return how much sensor pixels weigh in photo pixels, along one axis."""
    tap = pixel - tl.load(axis.start + at, mask=there, other=0)
    there = there & (tap >= 0) & (tap < axis.tap_count)
    return tl.load(axis.taps + at * axis.tap_count + tap, mask=there, other=0.0)


@triton.jit
def resize_back(grad, row, col, size, rows, cols, exists):
    """Return the gradient in the three codes of sensor pixels, from that in photos.

    Args:
        grad: an image's planes (3, *size). row, col: of sensor pixels.
    """
    height, width = size
    first_row = tl.load(rows.first + row, mask=exists, other=0)
    first_col = tl.load(cols.first + col, mask=exists, other=0)
    last_row = tl.load(rows.last + row, mask=exists, other=-1)
    last_col = tl.load(cols.last + col, mask=exists, other=-1)
    red = tl.full(exists.shape, 0.0, tl.float32)
    green = tl.full(exists.shape, 0.0, tl.float32)
    blue = tl.full(exists.shape, 0.0, tl.float32)
    for i in range(rows.photo_pixels):
        photo_row = first_row + i
        of_row = weight_in(rows, photo_row, row, photo_row <= last_row)
        for j in range(cols.photo_pixels):
            photo_col = first_col + j
            there = exists & (photo_row <= last_row) & (photo_col <= last_col)
            weight = of_row * weight_in(cols, photo_col, col, photo_col <= last_col)
            at = grad + photo_row * width + photo_col
            red += weight * tl.load(at, mask=there, other=0.0)
            green += weight * tl.load(at + height * width, mask=there, other=0.0)
            blue += weight * tl.load(at + 2 * height * width, mask=there, other=0.0)
    return red, green, blue
