"""The photo brought back to the image's frame.

Positions are float64: whether a photo shows a pixel at all is decided to within rounding.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.develop_arrays import RegistrationArrays
from moireaug.engine.gpu.tile import launch, size_of, store_colours, tile
from moireaug.engine.gpu.view import undistortion
from moireaug.geometry import grids

NEAR_HORIZON = tl.constexpr(grids.NEAR_HORIZON)


@triton.jit
def through(homography, x, y):
    """Return homogeneous coordinates of points x, y through a homography (9,)."""
    return (
        tl.load(homography) * x + tl.load(homography + 1) * y + tl.load(homography + 2),
        tl.load(homography + 3) * x + tl.load(homography + 4) * y + tl.load(homography + 5),
        tl.load(homography + 6) * x + tl.load(homography + 7) * y + tl.load(homography + 8),
    )


@triton.jit
def photo_place(row, col, size, registration, image, BENDS: tl.constexpr):
    """Return where an image's pixels lie on the photo, as a row and a column between the centres of
    its pixels, float64; and whether the photo shows them.

    registration: see `develop_arrays.RegistrationArrays`.
    """
    view, lens = registration.views + image * 9, registration.lenses + image * 2
    height, width = size
    half_height, half_width = height * 0.5, width * 0.5
    u, v, depth = through(
        view, col.to(tl.float64) + 0.5 - half_width, row.to(tl.float64) + 0.5 - half_height
    )
    nearness = 1.0 / tl.maximum(depth, NEAR_HORIZON)
    u, v = u * nearness, v * nearness
    if BENDS:
        square = (u * u + v * v) / (half_height * half_height + half_width * half_width)
        factor = undistortion(tl.sqrt(square), tl.load(lens), tl.load(lens + 1))
        u, v = u * factor, v * factor
    shown = (tl.abs(u) <= half_width) & (tl.abs(v) <= half_height)
    # the outermost pixels are repeated past their centres
    y = tl.minimum(tl.maximum(v + half_height - 0.5, 0.0), height - 1.0)
    x = tl.minimum(tl.maximum(u + half_width - 0.5, 0.0), width - 1.0)
    return y, x, shown


@triton.jit
def bilinear(plane, row, col, down, right, size, shown):
    """Return the values of a plane at fractions `down` and `right` past rows and columns."""
    width = size[1]
    row_below = tl.minimum(row + 1, size[0] - 1)
    col_right = tl.minimum(col + 1, width - 1)
    a = tl.load(plane + row * width + col, mask=shown, other=0.0)
    b = tl.load(plane + row * width + col_right, mask=shown, other=0.0)
    c = tl.load(plane + row_below * width + col, mask=shown, other=0.0)
    d = tl.load(plane + row_below * width + col_right, mask=shown, other=0.0)
    above, below = a + right * (b - a), c + right * (d - c)
    return above + down * (below - above)


@triton.jit
def register_kernel(
    out, photo, registration, size, BENDS: tl.constexpr, ROWS: tl.constexpr, COLS: tl.constexpr
):
    """Fill out (B, 3, *size) from photo (B, 3, *size): bilinear, black where it does not show the
    image."""
    image, row, col, inside = tile(size, ROWS, COLS)
    photo += image * 3 * size[0] * size[1]
    y, x, shown = photo_place(row, col, size, registration, image, BENDS)
    shown = shown & inside
    top, left = y.to(tl.int32), x.to(tl.int32)
    down, right = (y - top).to(tl.float32), (x - left).to(tl.float32)
    red = bilinear(photo, top, left, down, right, size, shown)
    green = bilinear(photo + size[0] * size[1], top, left, down, right, size, shown)
    blue = bilinear(photo + 2 * size[0] * size[1], top, left, down, right, size, shown)
    store_colours(out, image, row, col, size, inside, red, green, blue)


def register(photo: Tensor, registration: RegistrationArrays) -> Tensor:
    """Return photos (B, 3, H, W) in the image's frame."""
    out, bends = torch.empty_like(photo), registration.bends
    launch(register_kernel, out, photo, registration, size_of(photo), BENDS=bends)
    return out
