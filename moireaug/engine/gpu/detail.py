"""The filter of codes, which smooths colour and sharpens brightness, and its gradient. Rows are
blurred first, then columns.

A Gaussian mixes no colours and their mean is its own transpose: the filter's transpose is the
filter with the Gaussians' transposes, which differ in the outermost pixels alone. They are repeated
past the border, so that what falls there is theirs.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.develop_arrays import DetailArrays
from moireaug.engine.gpu.resize import first_pixel, resize_back, tap_weight
from moireaug.engine.gpu.tile import launch, load_colours, size_of, store_colours, tile
from moireaug.engine.gpu.tone import clip, is_unclipped

THIRD = tl.constexpr(1 / 3)


@triton.jit
def source_weight(weight, before, at, last, TRANSPOSED: tl.constexpr):
    """Return a tap's weight for pixels along one axis, of which `last` is the last.

    before: sum of the weights of the taps before this one.
    """
    if TRANSPOSED:
        after = 1 - before - weight
        return weight + tl.where(at == 0, after, 0.0) + tl.where(at == last, before, 0.0)
    else:
        return weight


@triton.jit
def blur_rows_kernel(
    soft,
    photo,
    detail,
    size,
    TRANSPOSED: tl.constexpr,
    ROWS: tl.constexpr,
    COLS: tl.constexpr,
):
    """Fill soft (B, 3, *size) with rows of photo (B, 3, *size) blurred: red and blue less the
    brightness, and the brightness."""
    image, row, col, inside = tile(size, ROWS, COLS)
    photo += image * 3 * size[0] * size[1]
    taps = detail.taps
    gaussians = detail.gaussians + image * 2 * taps
    red = tl.full(inside.shape, 0.0, tl.float32)
    blue = tl.full(inside.shape, 0.0, tl.float32)
    grey = tl.full(inside.shape, 0.0, tl.float32)
    before_chroma = 0.0
    before_sharp = 0.0
    for k in range(taps):
        x = col + k - taps // 2
        there = inside
        if TRANSPOSED:
            there = inside & (x >= 0) & (x < size[1])
        x = tl.minimum(tl.maximum(x, 0), size[1] - 1)
        r, g, b = load_colours(photo, row, x, size, there)
        mean = (r + g + b) * THIRD
        chroma = tl.load(gaussians + k)
        sharp = tl.load(gaussians + taps + k)
        of_colour = source_weight(chroma, before_chroma, col, size[1] - 1, TRANSPOSED)
        red += of_colour * (r - mean)
        blue += of_colour * (b - mean)
        grey += source_weight(sharp, before_sharp, col, size[1] - 1, TRANSPOSED) * mean
        before_chroma += chroma
        before_sharp += sharp
    store_colours(soft, image, row, col, size, inside, red, blue, grey)


@triton.jit
def filtered(photo, soft, detail, image, row, col, size, exists, TRANSPOSED: tl.constexpr):
    """Return the filtered colours of an image's pixels; photo and soft (B, 3, *size): all images,
    and their rows, blurred."""
    photo += image * 3 * size[0] * size[1]
    soft += image * 3 * size[0] * size[1]
    taps = detail.taps
    gaussians = detail.gaussians + image * 2 * taps
    amount = tl.load(detail.amount + image)
    red = tl.full(exists.shape, 0.0, tl.float32)
    blue = tl.full(exists.shape, 0.0, tl.float32)
    grey = tl.full(exists.shape, 0.0, tl.float32)
    before_chroma = 0.0
    before_sharp = 0.0
    for k in range(taps):
        y = row + k - taps // 2
        there = exists
        if TRANSPOSED:
            there = exists & (y >= 0) & (y < size[0])
        y = tl.minimum(tl.maximum(y, 0), size[0] - 1)
        r, b, mean = load_colours(soft, y, col, size, there)
        chroma = tl.load(gaussians + k)
        sharp = tl.load(gaussians + taps + k)
        of_colour = source_weight(chroma, before_chroma, row, size[0] - 1, TRANSPOSED)
        red += of_colour * r
        blue += of_colour * b
        grey += source_weight(sharp, before_sharp, row, size[0] - 1, TRANSPOSED) * mean
        before_chroma += chroma
        before_sharp += sharp
    r, g, b = load_colours(photo, row, col, size, exists)
    mean = (r + g + b) * THIRD
    bright = mean + amount * (mean - grey)
    return bright + red, bright - red - blue, bright + blue


@triton.jit
def finish_kernel(
    photo,
    codes,
    soft,
    detail,
    size,
    codes_size,
    ROWS: tl.constexpr,
    COLS: tl.constexpr,
):
    """Fill photo (B, 3, *size) with codes (B, 3, *codes_size) filtered, clipped and resized; soft:
    their rows, blurred."""
    image, row, col, inside = tile(size, ROWS, COLS)
    first_row = first_pixel(detail.rows, row, size[0])
    first_col = first_pixel(detail.cols, col, size[1])
    red = tl.full(inside.shape, 0.0, tl.float32)
    green = tl.full(inside.shape, 0.0, tl.float32)
    blue = tl.full(inside.shape, 0.0, tl.float32)
    for i in range(detail.rows.tap_count):
        y = tl.minimum(first_row + i, codes_size[0] - 1)
        of_row = tap_weight(detail.rows, row, i, size[0])
        for j in range(detail.cols.tap_count):
            x = tl.minimum(first_col + j, codes_size[1] - 1)
            weight = of_row * tap_weight(detail.cols, col, j, size[1])
            r, g, b = filtered(codes, soft, detail, image, y, x, codes_size, inside, False)
            red += weight * clip(r)
            green += weight * clip(g)
            blue += weight * clip(b)
    store_colours(photo, image, row, col, size, inside, clip(red), clip(green), clip(blue))


@triton.jit
def finish_back_kernel(
    codes_grad,
    grad,
    codes,
    soft,
    detail,
    size,
    codes_size,
    ROWS: tl.constexpr,
    COLS: tl.constexpr,
):
    """Fill codes_grad (B, 3, *codes_size) with the gradient in the filtered codes, from grad
    (B, 3, *size), that in photos; the rest as in `finish_kernel`."""
    image, row, col, inside = tile(codes_size, ROWS, COLS)
    grad += image * 3 * size[0] * size[1]
    r, g, b = filtered(codes, soft, detail, image, row, col, codes_size, inside, False)
    red, green, blue = resize_back(grad, row, col, size, detail.rows, detail.cols, inside)
    red = tl.where(is_unclipped(r), red, 0.0)
    green = tl.where(is_unclipped(g), green, 0.0)
    blue = tl.where(is_unclipped(b), blue, 0.0)
    store_colours(codes_grad, image, row, col, codes_size, inside, red, green, blue)


@triton.jit
def filter_back_kernel(out, grad, soft, detail, size, ROWS: tl.constexpr, COLS: tl.constexpr):
    """Fill out (B, 3, *size) with the gradient in codes, from that in the filtered ones and its
    rows, blurred by the transpose."""
    image, row, col, inside = tile(size, ROWS, COLS)
    red, green, blue = filtered(grad, soft, detail, image, row, col, size, inside, True)
    store_colours(out, image, row, col, size, inside, red, green, blue)


def _blurred_rows(photo: Tensor, detail: DetailArrays, *, transposed: bool) -> Tensor:
    soft, size = torch.empty_like(photo), size_of(photo)
    launch(blur_rows_kernel, soft, photo, detail, size, TRANSPOSED=transposed)
    return soft


def filter_detail(codes: Tensor, detail: DetailArrays) -> Tensor:
    """Return the photos (B, 3, H, W) of codes of sensor pixels (B, 3, h, w)."""
    soft = _blurred_rows(codes, detail, transposed=False)
    photo = codes.new_empty(len(codes), 3, len(detail.rows.start), len(detail.cols.start))
    launch(finish_kernel, photo, codes, soft, detail, size_of(photo), size_of(codes))
    return photo


def filter_detail_back(grad: Tensor, codes: Tensor, detail: DetailArrays) -> Tensor:
    """Return the gradient in codes (B, 3, h, w), from that in photos (B, 3, H, W)."""
    soft, filtered_grad = _blurred_rows(codes, detail, transposed=False), torch.empty_like(codes)
    sizes = size_of(grad), size_of(codes)
    launch(finish_back_kernel, filtered_grad, grad, codes, soft, detail, *sizes)
    soft, out = _blurred_rows(filtered_grad, detail, transposed=True), torch.empty_like(codes)
    launch(filter_back_kernel, out, filtered_grad, soft, detail, size_of(codes))
    return out
