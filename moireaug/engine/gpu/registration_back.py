"""The gradient in a photo in the camera's frame, from that in the image's frame.

Each photo pixel gathers from the image's pixels that look within a pixel of it. Where they look is
computed once, (B, 2, H, W) float32; those that may do so lie in a box, which the way from photo to
image gives.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor
from triton.language.standard import _elementwise_max

from moireaug.engine.gpu.develop_arrays import RegistrationArrays
from moireaug.engine.gpu.registration import photo_place, through
from moireaug.engine.gpu.tile import launch, load_colours, size_of, store_colours, tile

OFF_PHOTO = tl.constexpr(-9.0)  # where no photo pixel is within a pixel


@triton.jit
def places_kernel(
    places, registration, size, BENDS: tl.constexpr, ROWS: tl.constexpr, COLS: tl.constexpr
):
    """Fill places (B, 2, *size) float32 with the rows and columns of `photo_place`, OFF_PHOTO where
    the photo does not show a pixel."""
    image, row, col, inside = tile(size, ROWS, COLS)
    y, x, shown = photo_place(row, col, size, registration, image, BENDS)
    at = places + (image * 2 * size[0] + row) * size[1] + col
    tl.store(at, tl.where(shown, y, OFF_PHOTO).to(tl.float32), mask=inside)
    tl.store(at + size[0] * size[1], tl.where(shown, x, OFF_PHOTO).to(tl.float32), mask=inside)


@triton.jit
def greatest(values):
    """Return the greatest of a tile's values."""
    # not tl.max, which is a kernel itself and may not be the interpreter's
    return tl.reduce(values, None, _elementwise_max)


@triton.jit
def interval(value, depth, least_depth, slope_u, slope_v, depth_u, depth_v, step):
    """Return bounds of value / depth, over photo points up to `step` away along u and v. They take
    the change of each at its most, relative to that in the middle.

    Args:
        value, depth: in the middle. slope_u ... depth_v: their derivatives.
        least_depth: bound on what the image's pixels have.
    """
    middle = value / tl.maximum(depth, least_depth)
    rest = tl.abs(value - middle * depth)
    change = (tl.abs(slope_u - middle * depth_u) + tl.abs(slope_v - middle * depth_v)) * step
    nearest = tl.maximum(depth - (tl.abs(depth_u) + tl.abs(depth_v)) * step, least_depth)
    return middle - (rest + change) / nearest, middle + (rest + change) / nearest


@triton.jit
def pixels_between(low, high, count):
    """Return the first of pixels whose centres lie between coordinates about the middle of `count`,
    and how many there are."""
    first = tl.maximum(tl.ceil(low + count * 0.5 - 0.5), 0.0)
    last = tl.minimum(tl.floor(high + count * 0.5 - 0.5), count - 1.0)
    return tl.minimum(first, count).to(tl.int32), tl.maximum(last - first + 1.0, 0.0).to(tl.int32)


@triton.jit
def box_of(row, col, size, registration, image, BENDS: tl.constexpr):
    """Return the first row, first column and numbers of rows and columns of the image's pixels that
    may look within a pixel of photo pixels.

    registration: see `develop_arrays.RegistrationArrays`.
    """
    view, inverse = registration.views + image * 9, registration.inverses + image * 9
    lens = registration.lenses + image * 2
    half_height, half_width = size[0] * 0.5, size[1] * 0.5
    u, v = col.to(tl.float64) + 0.5 - half_width, row.to(tl.float64) + 0.5 - half_height
    step = 1.0
    if BENDS:
        square = (u * u + v * v) / (half_height * half_height + half_width * half_width)
        k1, k2 = tl.load(lens), tl.load(lens + 1)
        factor = 1.0 + square * (k1 + k2 * square)
        u, v = u * factor, v * factor
        # the most by which a pixel along both changes an ideal coordinate
        step = 1.0 + 3.5 * tl.abs(k1) + 6.0 * tl.abs(k2)
    x, y, depth = through(inverse, u, v)
    # depth is the reciprocal of that on the way there, which is greatest in one of the corners
    corner = tl.abs(tl.load(view + 6)) * half_width + tl.abs(tl.load(view + 7)) * half_height
    least_depth = 1.0 / (tl.load(view + 8) + corner)
    depth_u, depth_v = tl.load(inverse + 6), tl.load(inverse + 7)
    left, right = interval(
        x, depth, least_depth, tl.load(inverse), tl.load(inverse + 1), depth_u, depth_v, step
    )
    top, bottom = interval(
        y, depth, least_depth, tl.load(inverse + 3), tl.load(inverse + 4), depth_u, depth_v, step
    )
    first_row, row_count = pixels_between(top, bottom, size[0])
    first_col, col_count = pixels_between(left, right, size[1])
    return first_row, first_col, row_count, col_count


@triton.jit
def register_back_kernel(
    photo_grad,
    grad,
    places,
    registration,
    size,
    BENDS: tl.constexpr,
    ROWS: tl.constexpr,
    COLS: tl.constexpr,
):
    """Fill photo_grad (B, 3, *size) from grad (B, 3, *size) and what `places_kernel` filled."""
    height, width = size
    image, row, col, inside = tile(size, ROWS, COLS)
    grad += image * 3 * height * width
    places += image * 2 * height * width
    first_row, first_col, row_count, col_count = box_of(row, col, size, registration, image, BENDS)
    row_count = tl.where(inside & (col_count > 0), row_count, 0)
    col_count = tl.where(inside & (row_count > 0), col_count, 0)
    red = tl.full(inside.shape, 0.0, tl.float32)
    green = tl.full(inside.shape, 0.0, tl.float32)
    blue = tl.full(inside.shape, 0.0, tl.float32)
    most_cols = greatest(col_count)
    for i in range(greatest(row_count)):
        for j in range(most_cols):
            y, x = first_row + i, first_col + j
            there = (i < row_count) & (j < col_count)
            at = places + y * width + x
            down = tl.abs(tl.load(at, mask=there, other=OFF_PHOTO) - row)
            right = tl.abs(tl.load(at + height * width, mask=there, other=OFF_PHOTO) - col)
            weight = tl.maximum(1.0 - down, 0.0) * tl.maximum(1.0 - right, 0.0)
            r, g, b = load_colours(grad, y, x, size, weight > 0.0)
            red += weight * r
            green += weight * g
            blue += weight * b
    store_colours(photo_grad, image, row, col, size, inside, red, green, blue)


def register_back(grad: Tensor, registration: RegistrationArrays) -> Tensor:
    """Return the gradient in photos (B, 3, H, W) in the camera's frame, from that in the image's
    frame."""
    size, bends = size_of(grad), registration.bends
    places, photo_grad = grad.new_empty(len(grad), 2, *size), torch.empty_like(grad)
    launch(places_kernel, places, registration, size, BENDS=bends)
    launch(register_back_kernel, photo_grad, grad, places, registration, size, BENDS=bends)
    return photo_grad
