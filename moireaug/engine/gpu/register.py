"""The photo brought back to the image's frame, and the gradient on the way back.

Positions are float64: whether a photo shows a pixel at all is decided to within rounding.

On the way back, each photo pixel gathers from the image's pixels that look within a pixel of it.
Where they look is computed once, (B, 2, H, W) float32; those that may do so lie in a box, which the
way from photo to image gives.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor
from triton.language.standard import _elementwise_max

from moireaug.engine.gpu.develop_arrays import RegistrationArrays
from moireaug.engine.gpu.tile import Pixels, add, address, black, launch, load, store, tile
from moireaug.engine.gpu.view import homogeneous, to_photo

OFF_PHOTO = tl.constexpr(-9.0)  # where no photo pixel is within a pixel


@triton.jit
def about_middle(images, pixels):
    """Return columns and rows of pixels about the middle of their image, float64, and its half
    width and height."""
    half_height, half_width = images.height * 0.5, images.width * 0.5
    x, y = pixels.col.to(tl.float64) + 0.5 - half_width, pixels.row.to(tl.float64) + 0.5
    return (x, y - half_height), half_width, half_height


@triton.jit
def lens_of_photo(registration, image, half_width, half_height):
    """Return the lens of an image, as `view.to_photo` takes it."""
    distortion = registration.distortion + image * 2
    radius_scale = 1.0 / (half_height * half_height + half_width * half_width)
    return radius_scale, tl.load(distortion), tl.load(distortion + 1)


@triton.jit
def photo_place(images, pixels, registration, DISTORTS: tl.constexpr):
    """Return where an image's pixels lie on the photo, as a row and a column between the centres of
    its pixels, float64; and whether the photo shows them.

    registration: see `develop_arrays.RegistrationArrays`.
    """
    (x, y), half_width, half_height = about_middle(images, pixels)
    lens = lens_of_photo(registration, pixels.image, half_width, half_height)
    u, v = to_photo(x, y, registration.forward + pixels.image * 9, lens, DISTORTS)
    shown = pixels.exist & (tl.abs(u) <= half_width) & (tl.abs(v) <= half_height)
    # the outermost pixels are repeated past their centres
    row = tl.minimum(tl.maximum(v + half_height - 0.5, 0.0), images.height - 1.0)
    col = tl.minimum(tl.maximum(u + half_width - 0.5, 0.0), images.width - 1.0)
    return row, col, shown


@triton.jit
def blend(a, b, share):
    """Return the mean of two colours, of which b has this share."""
    return add(a, share, (b[0] - a[0], b[1] - a[1], b[2] - a[2]))


@triton.jit
def register_kernel(out, photo, registration, DISTORTS: tl.constexpr, TILE: tl.constexpr):
    """Fill out (B, 3, H, W) from photo (B, 3, H, W): bilinear, black where it does not show the
    image."""
    pixels = tile(out, TILE)
    y, x, shown = photo_place(photo, pixels, registration, DISTORTS)
    top, left = y.to(tl.int32), x.to(tl.int32)
    down, right = (y - top).to(tl.float32), (x - left).to(tl.float32)
    bottom = tl.minimum(top + 1, photo.height - 1)
    next_left = tl.minimum(left + 1, photo.width - 1)
    a = load(photo, Pixels(pixels.image, top, left, shown))
    b = load(photo, Pixels(pixels.image, top, next_left, shown))
    c = load(photo, Pixels(pixels.image, bottom, left, shown))
    d = load(photo, Pixels(pixels.image, bottom, next_left, shown))
    store(out, pixels, blend(blend(a, b, right), blend(c, d, right), down))


def register(photo: Tensor, registration: RegistrationArrays) -> Tensor:
    """Return photos (B, 3, H, W) in the image's frame."""
    out = torch.empty_like(photo)
    launch(register_kernel, out, photo, registration, DISTORTS=registration.distorts)
    return out


@triton.jit
def places_kernel(places, registration, DISTORTS: tl.constexpr, TILE: tl.constexpr):
    """Fill places (B, 2, H, W) float32 with the rows and columns of `photo_place`, OFF_PHOTO where
    the photo does not show a pixel."""
    pixels = tile(places, TILE)
    y, x, shown = photo_place(places, pixels, registration, DISTORTS)
    at, plane = address(places, pixels, 2), places.height * places.width
    tl.store(at, tl.where(shown, y, OFF_PHOTO).to(tl.float32), mask=pixels.exist)
    tl.store(at + plane, tl.where(shown, x, OFF_PHOTO).to(tl.float32), mask=pixels.exist)


@triton.jit
def greatest(values):
    """Return the greatest of a tile's values."""
    # not tl.max, which is a kernel itself and may not be the interpreter's
    return tl.reduce(values, None, _elementwise_max)


@triton.jit
def interval(value, depth, row, depth_row, min_depth, step):
    """Return bounds of value / depth, over photo points up to `step` away along u and v. They take
    the change of each at its most, relative to that in the middle.

    Args:
        value, depth: in the middle. row, depth_row: pointers to their derivatives in u and v.
        min_depth: bound on what the image's pixels have.
    """
    depth_u, depth_v = tl.load(depth_row), tl.load(depth_row + 1)
    middle = value / tl.maximum(depth, min_depth)
    rest = tl.abs(value - middle * depth)
    change_u = tl.abs(tl.load(row) - middle * depth_u)
    change = (change_u + tl.abs(tl.load(row + 1) - middle * depth_v)) * step
    nearest = tl.maximum(depth - (tl.abs(depth_u) + tl.abs(depth_v)) * step, min_depth)
    return middle - (rest + change) / nearest, middle + (rest + change) / nearest


@triton.jit
def pixels_between(low, high, count):
    """Return the first of pixels whose centres lie between coordinates about the middle of `count`,
    and how many there are."""
    first = tl.maximum(tl.ceil(low + count * 0.5 - 0.5), 0.0)
    last = tl.minimum(tl.floor(high + count * 0.5 - 0.5), count - 1.0)
    return tl.minimum(first, count).to(tl.int32), tl.maximum(last - first + 1.0, 0.0).to(tl.int32)


@triton.jit
def box_of(images, pixels, registration, DISTORTS: tl.constexpr):
    """Return the first row, first column and numbers of rows and columns of the image's pixels that
    may look within a pixel of photo pixels.

    registration: see `develop_arrays.RegistrationArrays`.
    """
    forward = registration.forward + pixels.image * 9
    inverse = registration.inverses + pixels.image * 9
    (u, v), half_width, half_height = about_middle(images, pixels)
    step = 1.0
    if DISTORTS:
        radius_scale, k1, k2 = lens_of_photo(registration, pixels.image, half_width, half_height)
        square = (u * u + v * v) * radius_scale
        factor = 1.0 + square * (k1 + k2 * square)
        u, v = u * factor, v * factor
        # the most by which a pixel along both changes an ideal coordinate
        step = 1.0 + 3.5 * tl.abs(k1) + 6.0 * tl.abs(k2)
    x, y, depth = homogeneous(inverse, u, v)
    # depth is the reciprocal of that on the way there, which is greatest in one of the corners
    corner = tl.abs(tl.load(forward + 6)) * half_width + tl.abs(tl.load(forward + 7)) * half_height
    min_depth = 1.0 / (tl.load(forward + 8) + corner)
    left, right = interval(x, depth, inverse, inverse + 6, min_depth, step)
    top, bottom = interval(y, depth, inverse + 3, inverse + 6, min_depth, step)
    first_row, row_count = pixels_between(top, bottom, images.height)
    first_col, col_count = pixels_between(left, right, images.width)
    return first_row, first_col, row_count, col_count


@triton.jit
def register_back_kernel(
    photo_grad, grad, places, registration, DISTORTS: tl.constexpr, TILE: tl.constexpr
):
    """Fill photo_grad (B, 3, H, W) from grad (B, 3, H, W) and what `places_kernel` filled."""
    pixels = tile(photo_grad, TILE)
    first_row, first_col, row_count, col_count = box_of(grad, pixels, registration, DISTORTS)
    row_count = tl.where(pixels.exist & (col_count > 0), row_count, 0)
    col_count = tl.where(pixels.exist & (row_count > 0), col_count, 0)
    total, max_cols = black(pixels.exist), greatest(col_count)
    for i in range(greatest(row_count)):
        for j in range(max_cols):
            exist, y, x = (i < row_count) & (j < col_count), first_row + i, first_col + j
            at = address(places, Pixels(pixels.image, y, x, exist), 2)
            down = tl.abs(tl.load(at, mask=exist, other=OFF_PHOTO) - pixels.row)
            at += places.height * places.width
            right = tl.abs(tl.load(at, mask=exist, other=OFF_PHOTO) - pixels.col)
            weight = tl.maximum(1.0 - down, 0.0) * tl.maximum(1.0 - right, 0.0)
            total = add(total, weight, load(grad, Pixels(pixels.image, y, x, weight > 0.0)))
    store(photo_grad, pixels, total)


def register_back(grad: Tensor, registration: RegistrationArrays) -> Tensor:
    """Return the gradient in photos (B, 3, H, W) in the camera's frame, from that in the image's
    frame."""
    places, photo_grad = grad.new_empty(len(grad), 2, *grad.shape[2:]), torch.empty_like(grad)
    distorts = registration.distorts
    launch(places_kernel, places, registration, DISTORTS=distorts)
    launch(register_back_kernel, photo_grad, grad, places, registration, DISTORTS=distorts)
    return photo_grad
