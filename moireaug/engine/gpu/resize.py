"""A linear resize along both axes, and the gradient on the way back. `rows` and `cols` are each a
`development_records.Resize`."""

from __future__ import annotations

import triton
import triton.language as tl

from moireaug.engine.gpu.tile import Pixels, add, black, load
from moireaug.engine.gpu.tone import clip


@triton.jit
def first_pixel(axis, at):
    """Return the first sensor pixel, along one axis, that photo pixels are made from."""
    return tl.load(axis.start + at, mask=at < axis.photo_size, other=0)


@triton.jit
def tap_weight(axis, at, tap):
    """Return how much the tap-th sensor pixel from the first on weighs in photo pixels."""
    return tl.load(axis.taps + at * axis.tap_count + tap, mask=at < axis.photo_size, other=0.0)


@triton.jit
def weight_in(axis, at, pixel, exist):
    """Return how much sensor pixels weigh in photo pixels, along one axis."""
    tap = pixel - tl.load(axis.start + at, mask=exist, other=0)
    exist = exist & (tap >= 0) & (tap < axis.tap_count)
    return tl.load(axis.taps + at * axis.tap_count + tap, mask=exist, other=0.0)


@triton.jit
def resized(CODES: tl.constexpr, source, pixels, rows, cols):
    """Return the codes of photo pixels.

    CODES: device function of `source` and Pixels of the sensor; returns their codes.
    """
    top, left = first_pixel(rows, pixels.row), first_pixel(cols, pixels.col)
    total = black(pixels.exist)
    for i in range(rows.tap_count):
        y, of_row = tl.minimum(top + i, rows.size - 1), tap_weight(rows, pixels.row, i)
        for j in range(cols.tap_count):
            x = tl.minimum(left + j, cols.size - 1)
            weight = of_row * tap_weight(cols, pixels.col, j)
            codes = CODES(source, Pixels(pixels.image, y, x, pixels.exist))
            total = add(total, weight, codes)
    # weights of codes in [0, 1] sum to 1, but for rounding
    return clip(total[0]), clip(total[1]), clip(total[2])


@triton.jit
def resize_back(grad, pixels, rows, cols):
    """Return the gradient in the codes of sensor pixels, from that in photos."""
    top = tl.load(rows.first + pixels.row, mask=pixels.exist, other=0)
    left = tl.load(cols.first + pixels.col, mask=pixels.exist, other=0)
    bottom = tl.load(rows.last + pixels.row, mask=pixels.exist, other=-1)
    right = tl.load(cols.last + pixels.col, mask=pixels.exist, other=-1)
    total = black(pixels.exist)
    for i in range(rows.target_count):
        y = top + i
        of_row = weight_in(rows, y, pixels.row, y <= bottom)
        for j in range(cols.target_count):
            x = left + j
            weight = of_row * weight_in(cols, x, pixels.col, x <= right)
            exist = pixels.exist & (y <= bottom) & (x <= right)
            total = add(total, weight, load(grad, Pixels(pixels.image, y, x, exist)))
    return total
