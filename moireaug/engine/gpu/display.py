"""The picture as the panel shows it: decoded, raised to the black level, blurred by the prefilter
and, on a panel of fewer pixels, shrunk; and the backward pass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.lower.exposure_records import Camera, Exposure
from moireaug.exposure.displayed import EDGE_PIXELS

LEAD = tl.constexpr(EDGE_PIXELS)
BLOCK = 256  # pixels of a program


class Shown(NamedTuple):
    """What panels of at most the picture's pixels show.

    Args:
        light: (B, 3, h, w) float32. Beyond its edges it is as on them.
        lead: how many of its pixels lie ahead of the picture, above and to the left.
    """

    light: Tensor
    lead: int


def numbers_of(exposure: Exposure) -> dict[str, np.ndarray]:
    """Return the numbers that `show` reads, (B,) float32 each."""
    return {
        "black": exposure.black,
        "neighbour_share": exposure.neighbour_share,
        "pixel_scale": _pixel_scale(exposure).astype(np.float32),
    }


def show(picture: Tensor, exposure: Exposure, numbers: dict[str, Tensor]) -> Shown:
    """Return what panels show of pictures (B, 3, H, W), float32 or uint8; numbers: from
    `numbers_of`, uploaded."""
    n, _, h, w = picture.shape
    light = torch.empty(n, 3, h, w, dtype=torch.float32, device=picture.device)
    blurs = bool(exposure.neighbour_share.any())
    is_byte = picture.dtype == torch.uint8
    _light[(triton.cdiv(h * w, BLOCK), 3 * n)](
        light, picture.contiguous(), numbers["black"], numbers["neighbour_share"], h, w,
        BYTE=is_byte, CODED=exposure.coded, BLURS=blurs, BLOCK=BLOCK,
    )  # fmt: skip
    scale = _pixel_scale(exposure)
    if not len(scale) or scale.min() >= 1:
        return Shown(light, 0)
    rows, cols = (math.ceil(scale.max() * size) + 2 * EDGE_PIXELS for size in (h, w))
    narrow = light.new_empty(n, 3, h, cols)
    _shrink_axis(narrow, light, 3, scale, numbers, back=False)
    out = light.new_empty(n, 3, rows, cols)
    _shrink_axis(out, narrow, 2, scale, numbers, back=False)
    return Shown(out, EDGE_PIXELS)


def show_back(
    grad: Tensor, picture: Tensor, exposure: Exposure, numbers: dict[str, Tensor]
) -> Tensor:
    """Return the gradient in the picture, from that in `Shown.light`."""
    n, _, h, w = picture.shape
    scale = _pixel_scale(exposure)
    if len(scale) and scale.min() < 1:
        narrow = grad.new_zeros(n, 3, h, grad.shape[3])
        _shrink_axis(grad, narrow, 2, scale, numbers, back=True)
        grad = grad.new_zeros(n, 3, h, w)
        _shrink_axis(narrow, grad, 3, scale, numbers, back=True)
    out = torch.empty_like(picture, memory_format=torch.contiguous_format)
    _light_back[(triton.cdiv(h * w, BLOCK), 3 * n)](
        out, grad, picture.contiguous(), numbers["black"], numbers["neighbour_share"], h, w,
        CODED=exposure.coded, BLURS=bool(exposure.neighbour_share.any()), BLOCK=BLOCK,
    )  # fmt: skip
    return out


def _pixel_scale(exposure: Exposure) -> np.ndarray:
    """Return the pixels, per picture pixel, of the panel of at most the picture's, (B,)."""
    return np.minimum(exposure.cameras[:, Camera._fields.index("alpha")], 1)


def _shrink_axis(
    short: Tensor,
    long: Tensor,
    axis: int,
    scale: np.ndarray,
    numbers: dict[str, Tensor],
    *,
    back: bool,
) -> None:
    """Launch `_shrink` along an axis of (B, 3, h, w); scale: from `_pixel_scale`."""
    lines_per_image, inner = math.prod(long.shape[1:axis]), math.prod(long.shape[axis + 1 :])
    n, taps = short.numel(), math.ceil(2 / scale.min())
    sizes = long.shape[axis], short.shape[axis]
    _shrink[(triton.cdiv(n, BLOCK),)](
        short, long, numbers["pixel_scale"], n, lines_per_image, *sizes, inner, taps,
        BACK=back, BLOCK=BLOCK,
    )  # fmt: skip


@triton.jit
def decode(code):
    """Return the light of an sRGB code."""
    root = tl.maximum(code + 0.055, 0.0) / 1.055
    curve = tl.exp2(2.4 * tl.log2(tl.maximum(root, 1e-6)))
    return tl.where(code > 0.04045, curve, code / 12.92)


@triton.jit
def decode_slope(code):
    """Return the derivative of `decode`."""
    root = tl.maximum(code + 0.055, 0.0) / 1.055
    curve = 2.4 / 1.055 * tl.exp2(1.4 * tl.log2(tl.maximum(root, 1e-6)))
    return tl.where(code > 0.04045, curve, 1.0 / 12.92)


@triton.jit
def light_at(pixels, at, valid, black, BYTE: tl.constexpr, CODED: tl.constexpr):
    """Return the light of a picture's pixels, or what they hold if it is not CODED and black is
    0."""
    value = tl.load(pixels + at, mask=valid, other=0).to(tl.float32)
    if BYTE:
        value = value * (1.0 / 255.0)
    if CODED:
        value = decode(value)
    return value + black * (1.0 - value)


@triton.jit
def blurred(
    pixels, pixel, h, w, black, share, BYTE: tl.constexpr, CODED: tl.constexpr, BLURS: tl.constexpr
):
    """Return the light of the pixels (n,) of one channel of a picture, of which a share comes from
    a pixel's neighbours along each axis, as in `prefilter.blur_by_neighbours`. It is its own
    transpose."""
    valid, row, col = pixel < h * w, pixel // w, pixel % w
    if not BLURS:
        return light_at(pixels, pixel, valid, black, BYTE, CODED)
    total = share * 0.0
    for i in tl.static_range(3):
        for j in tl.static_range(3):
            y = tl.minimum(tl.maximum(row + (i - 1), 0), h - 1)
            x = tl.minimum(tl.maximum(col + (j - 1), 0), w - 1)
            down = 1.0 - share if i == 1 else 0.5 * share
            across = 1.0 - share if j == 1 else 0.5 * share
            total += down * across * light_at(pixels, y * w + x, valid, black, BYTE, CODED)
    return total


@triton.jit
def _light(
    out, picture, black, share, h, w,
    BYTE: tl.constexpr, CODED: tl.constexpr, BLURS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill out (B, 3, H, W) with the light of pictures: a program for BLOCK pixels of a channel."""
    plane = tl.program_id(1)
    pixel = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    start = plane.to(tl.int64) * h * w
    black, share = tl.load(black + plane // 3), tl.load(share + plane // 3)
    light = blurred(picture + start, pixel, h, w, black, share, BYTE, CODED, BLURS)
    tl.store(out + start + pixel, light, mask=pixel < h * w)


@triton.jit
def _light_back(
    out, grad, picture, black, share, h, w,
    CODED: tl.constexpr, BLURS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill out (B, 3, H, W) with the gradient in pictures, from that in their light."""
    plane = tl.program_id(1)
    pixel = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    start, valid = plane.to(tl.int64) * h * w, pixel < h * w
    black, share = tl.load(black + plane // 3), tl.load(share + plane // 3)
    slope = 1.0 - black
    if CODED:
        slope = slope * decode_slope(tl.load(picture + start + pixel, mask=valid, other=0.0))
    back = blurred(grad + start, pixel, h, w, 0.0, share, False, False, BLURS)
    tl.store(out + start + pixel, back * slope, mask=valid)


@triton.jit
def _shrink(
    short, long, pixel_scale, n, lines_per_image, long_size, short_size, inner, taps,
    BACK: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill `short` (lines, short_size, inner), n values, from `long` (lines, long_size, inner) as
    `displayed.shrink` does along one axis; or, BACK, add to long the gradient in it from that in
    short. A program for BLOCK values."""
    value = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid, beside, line = value < n, value % inner, value // inner // short_size
    scale = tl.load(pixel_scale + line // lines_per_image, mask=valid, other=1.0)
    place = (value // inner % short_size).to(tl.float32)
    centre = (place + (0.5 - LEAD)) / scale
    first = tl.ceil(centre - 1.0 / scale - 0.5)
    total = tl.full([BLOCK], 0.0, tl.float32)
    for tap in range(taps):
        total += tl.maximum(1.0 - tl.abs(first + tap + 0.5 - centre) * scale, 0.0)
    light = tl.full([BLOCK], 0.0, tl.float32)
    if BACK:
        light = tl.load(short + value, mask=valid, other=0.0) / total
    for tap in range(taps):
        weight = tl.maximum(1.0 - tl.abs(first + tap + 0.5 - centre) * scale, 0.0)
        pixel = tl.minimum(tl.maximum((first + tap).to(tl.int32), 0), long_size - 1)
        at = long + (line * long_size + pixel) * inner + beside
        if BACK:
            tl.atomic_add(at, weight * light, mask=valid & (weight > 0.0))
        else:
            light += weight * tl.load(at, mask=valid, other=0.0)
    if not BACK:
        tl.store(short + value, light / total, mask=valid)
