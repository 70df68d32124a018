"""The filter of codes, which smooths colour and sharpens brightness, and its gradient. Rows are
blurred first, then columns. Besides these rows a pixel reads its own colours alone, so that others
can take their place.

A Gaussian mixes no colours and their mean is its own transpose: the filter's transpose is the
filter with the Gaussians' transposes, which differ in the outermost pixels alone. They are repeated
past the border, so that what falls there is theirs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.camera.effects.detail import MIN_SIGMA
from moireaug.engine.gpu.tile import Pixels, black, clip, clip_back, launch, load, store, tile
from moireaug.engine.lower.development_records import Detail

THIRD = tl.constexpr(1 / 3)


class DetailArrays(NamedTuple):
    """What filters codes, see `development_records.Detail`.

    Args:
        gaussians: (B, 2, taps) float32, the Gaussians of colour and of the unsharp mask, each of
            sum 1. taps: of either.
        amount: (B,) float32.
    """

    gaussians: Any
    taps: int
    amount: Any


def detail_arrays(detail: Detail) -> DetailArrays:
    """Return the DetailArrays of a Detail, not yet on a device."""
    half = max(detail.chroma_size, detail.sharp_size) // 2
    at = np.arange(-half, half + 1)
    gaussians = []
    for sigma, size in ((detail.chroma, detail.chroma_size), (detail.sharp, detail.sharp_size)):
        sigma = np.maximum(sigma, MIN_SIGMA)[:, None]
        weight = np.where(abs(at) <= size // 2, np.exp(-(at**2) / (2 * sigma**2)), 0.0)
        gaussians.append(weight / weight.sum(1, keepdims=True))
    return DetailArrays(np.stack(gaussians, 1), len(at), detail.amount)


@triton.jit
def split(colours):
    """Return red and blue less the brightness, and the brightness."""
    mean = (colours[0] + colours[1] + colours[2]) * THIRD
    return colours[0] - mean, colours[2] - mean, mean


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
def blurred_detail(images, pixels, detail, ALONG_ROWS: tl.constexpr, TRANSPOSED: tl.constexpr):
    """Return what `split` does, blurred along rows, or along columns of images that have been."""
    at, last = pixels.row, images.height - 1
    if ALONG_ROWS:
        at, last = pixels.col, images.width - 1
    gaussians = detail.gaussians + pixels.image * 2 * detail.taps
    red, blue, grey = black(pixels.exist)
    chroma_before, sharp_before = 0.0, 0.0
    for k in range(detail.taps):
        source, exist = at + k - detail.taps // 2, pixels.exist
        if TRANSPOSED:
            exist = exist & (source >= 0) & (source <= last)
        source = tl.minimum(tl.maximum(source, 0), last)
        if ALONG_ROWS:
            r, b, mean = split(load(images, Pixels(pixels.image, pixels.row, source, exist)))
        else:
            r, b, mean = load(images, Pixels(pixels.image, source, pixels.col, exist))
        chroma, sharp = tl.load(gaussians + k), tl.load(gaussians + detail.taps + k)
        of_colour = source_weight(chroma, chroma_before, at, last, TRANSPOSED)
        red += of_colour * r
        blue += of_colour * b
        grey += source_weight(sharp, sharp_before, at, last, TRANSPOSED) * mean
        chroma_before += chroma
        sharp_before += sharp
    return red, blue, grey


@triton.jit
def blur_rows_kernel(soft, images, detail, TRANSPOSED: tl.constexpr, TILE: tl.constexpr):
    """Fill soft (B, 3, h, w) with what `split` makes of images, blurred along rows."""
    pixels = tile(soft, TILE)
    store(soft, pixels, blurred_detail(images, pixels, detail, True, TRANSPOSED))


@triton.jit
def filtered(source, pixels, TRANSPOSED: tl.constexpr):
    """Return the filtered colours of pixels; source: images, what `blur_rows_kernel` made of them,
    and the detail."""
    images, soft, detail = source
    red, blue, grey = blurred_detail(soft, pixels, detail, False, TRANSPOSED)
    _, _, mean = split(load(images, pixels))
    bright = mean + tl.load(detail.amount + pixels.image) * (mean - grey)
    return bright + red, bright - red - blue, bright + blue


@triton.jit
def detail_kernel(photo, codes, soft, detail, TILE: tl.constexpr):
    """Fill photo (B, 3, h, w) with codes of its shape filtered and clipped; soft: their rows,
    blurred."""
    pixels = tile(photo, TILE)
    r, g, b = filtered((codes, soft, detail), pixels, False)
    store(photo, pixels, (clip(r), clip(g), clip(b)))


@triton.jit
def detail_back_kernel(codes_grad, grad, codes, soft, detail, TILE: tl.constexpr):
    """Fill codes_grad (B, 3, h, w) with the gradient in the filtered codes, from that in
    photos; the rest as in `detail_kernel`."""
    pixels = tile(codes_grad, TILE)
    r, g, b = filtered((codes, soft, detail), pixels, False)
    red, green, blue = load(grad, pixels)
    store(codes_grad, pixels, (clip_back(red, r), clip_back(green, g), clip_back(blue, b)))


@triton.jit
def filter_back_kernel(out, grad, soft, detail, TILE: tl.constexpr):
    """Fill out (B, 3, h, w) with the gradient in codes, from that in the filtered ones and its
    rows, blurred by the transpose."""
    pixels = tile(out, TILE)
    store(out, pixels, filtered((grad, soft, detail), pixels, True))


def filter_detail(codes: Tensor, detail: DetailArrays) -> Tensor:
    """Return the photos of codes (B, 3, h, w), which it overwrites."""
    soft = torch.empty_like(codes)
    launch(blur_rows_kernel, soft, codes, detail, TRANSPOSED=False)
    launch(detail_kernel, codes, codes, soft, detail)
    return codes


def filter_detail_back(grad: Tensor, codes: Tensor, detail: DetailArrays) -> Tensor:
    """Return the gradient in codes (B, 3, h, w), which it overwrites, from that in photos."""
    soft, codes_grad = torch.empty_like(codes), codes
    launch(blur_rows_kernel, soft, codes, detail, TRANSPOSED=False)
    launch(detail_back_kernel, codes_grad, grad, codes, soft, detail)
    launch(blur_rows_kernel, soft, codes_grad, detail, TRANSPOSED=True)
    launch(filter_back_kernel, codes_grad, codes_grad, soft, detail)
    return codes_grad
