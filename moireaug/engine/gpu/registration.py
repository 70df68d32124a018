"""The photo brought back to the image's frame.

Positions are float64: whether a photo shows a pixel at all is decided to within rounding.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.develop_arrays import RegistrationArrays
from moireaug.engine.gpu.tile import Pixels, add, launch, load, store, tile
from moireaug.engine.gpu.view import to_photo


@triton.jit
def about_middle(images, pixels):
    """Return columns and rows of pixels about the middle of their image, float64, and its half
    width and height."""
    half_height, half_width = images.height * 0.5, images.width * 0.5
    x, y = pixels.col.to(tl.float64) + 0.5 - half_width, pixels.row.to(tl.float64) + 0.5
    return (x, y - half_height), half_width, half_height


@triton.jit
def lens_of(registration, image, half_width, half_height):
    """Return the lens of an image, as `view.to_photo` takes it."""
    lens = registration.lenses + image * 2
    bend = 1.0 / (half_height * half_height + half_width * half_width)
    return bend, tl.load(lens), tl.load(lens + 1)


@triton.jit
def photo_place(images, pixels, registration, BENDS: tl.constexpr):
    """Return where an image's pixels lie on the photo, as a row and a column between the centres of
    its pixels, float64; and whether the photo shows them.

    registration: see `develop_arrays.RegistrationArrays`.
    """
    (x, y), half_width, half_height = about_middle(images, pixels)
    lens = lens_of(registration, pixels.image, half_width, half_height)
    u, v = to_photo(x, y, registration.views + pixels.image * 9, lens, BENDS)
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
def register_kernel(out, photo, registration, BENDS: tl.constexpr, TILE: tl.constexpr):
    """Fill out (B, 3, H, W) from photo (B, 3, H, W): bilinear, black where it does not show the
    image."""
    pixels = tile(out, TILE)
    y, x, shown = photo_place(photo, pixels, registration, BENDS)
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
    launch(register_kernel, out, photo, registration, BENDS=registration.bends)
    return out
