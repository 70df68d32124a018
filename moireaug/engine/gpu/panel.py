"""The picture as the panel shows it: decoded, raised to the black level, blurred by the prefilter
and, on a panel of fewer pixels, shrunk; and the backward pass.

A finer panel shows what lies between the picture's pixels: kernels look that up where they need it
(see `bins`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.camera.exposure.screen import EDGE_PIXELS
from moireaug.engine.gpu.arrays import CAMERA_FIELDS, camera_field
from moireaug.engine.gpu.physics import decoding
from moireaug.engine.gpu.physics import panel as triangle
from moireaug.engine.gpu.tile import block
from moireaug.engine.gpu.view import ALPHA, load32
from moireaug.engine.lower.exposure_records import Camera, Exposure

LEAD = tl.constexpr(EDGE_PIXELS)
BLOCK = 256  # pixels of a program
# by axis of (B, 3, h, w)
LEAD_FIELDS = {2: camera_field("lead_y"), 3: camera_field("lead_x")}


class Screen(NamedTuple):
    """What panels of at most the picture's pixels show. Past its edges the outermost pixels are
    repeated.

    Args:
        light: (B, 3, rows, columns) float32. pixels: columns and rows. lead: how many of either lie
            ahead of the picture. size: width and height of the picture.
    """

    light: Any
    pixels: tuple[int, int]
    lead: int
    size: tuple[int, int]


class Shrinking(NamedTuple):
    """Sizes that `shrink_kernel` reads: of both arrays along the axis, of the lines of an image and
    of the values beside each other, and how many pixels make one."""

    long: int
    short: int
    lines: int
    inner: int
    taps: int


def pixel_scale_of(exposure: Exposure) -> np.ndarray:
    """Return pixels per picture pixel of panels of at most the picture's, (B,)."""
    return np.minimum(_field_of(exposure, "alpha"), 1)


def _field_of(exposure: Exposure, name: str) -> np.ndarray:
    return exposure.cameras[:, Camera._fields.index(name)]


def show(picture: Tensor, exposure: Exposure, uploaded: Exposure) -> Screen:
    """Return what panels show of pictures (B, 3, H, W), float32 or uint8."""
    n, _, h, w = picture.shape
    light = torch.empty(n, 3, h, w, dtype=torch.float32, device=picture.device)
    _launch(picture_light_kernel, light, exposure, uploaded, picture.contiguous())
    scale = pixel_scale_of(exposure)
    if scale.min() >= 1:
        return Screen(light, (w, h), 0, (w, h))
    leads = (_field_of(exposure, name).max() for name in ("lead_y", "lead_x"))
    rows, cols = (
        math.ceil(scale.max() * size + lead) + 2 * EDGE_PIXELS
        for size, lead in zip((h, w), leads, strict=True)
    )
    narrow, short = light.new_empty(n, 3, h, cols), light.new_empty(n, 3, rows, cols)
    _shrink_axis(narrow, light, 3, scale, uploaded.cameras, back=False)
    _shrink_axis(short, narrow, 2, scale, uploaded.cameras, back=False)
    return Screen(short, (cols, rows), EDGE_PIXELS, (w, h))


def show_back(grad: Tensor, picture: Tensor, exposure: Exposure, uploaded: Exposure) -> Tensor:
    """Return the gradient in the picture, from that in `Screen.light`; arguments as in `show`."""
    n, _, h, w = picture.shape
    scale = pixel_scale_of(exposure)
    if scale.min() < 1:
        narrow, light = grad.new_zeros(n, 3, h, grad.shape[3]), grad.new_zeros(n, 3, h, w)
        _shrink_axis(grad, narrow, 2, scale, uploaded.cameras, back=True)
        _shrink_axis(narrow, light, 3, scale, uploaded.cameras, back=True)
        grad = light
    out = torch.empty_like(picture, memory_format=torch.contiguous_format)
    _launch(picture_light_back_kernel, out, exposure, uploaded, grad, picture.contiguous())
    return out


def _launch(
    kernel: Any, out: Tensor, exposure: Exposure, uploaded: Exposure, *images: Tensor
) -> None:
    """Run a kernel that fills out (B, 3, H, W) from images."""
    n, channels, h, w = out.shape
    kernel[(n * channels * triton.cdiv(h * w, BLOCK),)](
        out, *images, (uploaded.black, uploaded.neighbour_share), (w, h),
        CODED=exposure.coded, BLURS=bool(exposure.neighbour_share.any()), BLOCK=BLOCK,
    )  # fmt: skip


def _shrink_axis(
    short: Tensor, long: Tensor, axis: int, scale: np.ndarray, cameras: Any, *, back: bool
) -> None:
    """Launch `shrink_kernel` along an axis of (B, 3, h, w); scale: from `pixel_scale_of`."""
    lines, inner = math.prod(long.shape[1:axis]), math.prod(long.shape[axis + 1 :])
    taps, n = math.ceil(2 / scale.min()), short.numel()
    sizes = Shrinking(long.shape[axis], short.shape[axis], lines, inner, taps)
    programs = (triton.cdiv(n, BLOCK),)
    shrink_kernel[programs](
        short, long, cameras, n, sizes, LEAD_FIELD=LEAD_FIELDS[axis], BACK=back, BLOCK=BLOCK
    )


@triton.jit
def pixel_scale(camera):
    """Return `pixel_scale_of` a Camera, or of several, float32."""
    return tl.minimum(tl.load(camera + ALPHA), 1.0).to(tl.float32)


@triton.jit
def light_at(pixels, at, valid, black, CODED: tl.constexpr):
    """Return the light of a picture's pixels, or what they hold if it is not CODED and black is
    0."""
    value = tl.load(pixels + at, mask=valid, other=0).to(tl.float32)
    if pixels.dtype.element_ty == tl.uint8:
        value = value * (1.0 / 255.0)
    if CODED:
        value = decoding.light_of_code(value)
    return value + black * (1.0 - value)


@triton.jit
def blurred_light(pixels, pixel, size, black, share, CODED: tl.constexpr, BLURS: tl.constexpr):
    """Return the light of the pixels (n,) of one channel of a picture, of which a share comes from
    a pixel's neighbours along each axis, as in `prefilter.blur_by_neighbours`. It is its own
    transpose."""
    w, h = size
    valid, row, col = pixel < h * w, pixel // w, pixel % w
    if not BLURS:
        return light_at(pixels, pixel, valid, black, CODED)
    total = share * 0.0
    for i in tl.static_range(3):
        for j in tl.static_range(3):
            y = tl.minimum(tl.maximum(row + (i - 1), 0), h - 1)
            x = tl.minimum(tl.maximum(col + (j - 1), 0), w - 1)
            down = 1.0 - share if i == 1 else 0.5 * share
            across = 1.0 - share if j == 1 else 0.5 * share
            total += down * across * light_at(pixels, y * w + x, valid, black, CODED)
    return total


@triton.jit
def picture_light_kernel(
    out, picture, added, size, CODED: tl.constexpr, BLURS: tl.constexpr, BLOCK: tl.constexpr
):
    """Fill out (B, 3, H, W) with the light of pictures: a program for BLOCK pixels of a channel.

    added: the exposure's `black` and `neighbour_share`.
    """
    plane, pixel = block(size[0] * size[1], BLOCK)
    start, image = plane.to(tl.int64) * size[0] * size[1], plane // 3
    black, share = tl.load(added[0] + image), tl.load(added[1] + image)
    light = blurred_light(picture + start, pixel, size, black, share, CODED, BLURS)
    tl.store(out + start + pixel, light, mask=pixel < size[0] * size[1])


@triton.jit
def picture_light_back_kernel(
    out, grad, picture, added, size, CODED: tl.constexpr, BLURS: tl.constexpr, BLOCK: tl.constexpr
):
    """Fill out (B, 3, H, W) with the gradient in pictures, from that in their light; added: as in
    `picture_light_kernel`."""
    plane, pixel = block(size[0] * size[1], BLOCK)
    start, valid = plane.to(tl.int64) * size[0] * size[1], pixel < size[0] * size[1]
    share = tl.load(added[1] + plane // 3)
    back = blurred_light(grad + start, pixel, size, 0.0, share, False, BLURS)
    back *= 1.0 - tl.load(added[0] + plane // 3)
    if CODED:
        back *= decoding.light_slope(tl.load(picture + start + pixel, mask=valid, other=0.0))
    tl.store(out + start + pixel, back, mask=valid)


@triton.jit
def shrink_kernel(
    short, long, cameras, n, sizes,
    LEAD_FIELD: tl.constexpr, BACK: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill `short`, n values, (lines, sizes.short, sizes.inner) from `long` (lines, sizes.long,
    sizes.inner) as `screen.shrink` does along one axis; or, BACK, add to long the gradient in it
    from that in short. A program for BLOCK values.

    LEAD_FIELD: place in a Camera of how far the panel begins before the picture along the axis.
    """
    value = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    valid, beside, place = value < n, value % sizes.inner, value // sizes.inner
    line = place // sizes.short
    camera = cameras + tl.where(valid, line // sizes.lines, 0) * CAMERA_FIELDS
    scale, lead = pixel_scale(camera), load32(camera, LEAD_FIELD)
    pixel = (place % sizes.short).to(tl.float32)
    centre = triangle.centre_on_picture(pixel, LEAD + lead, scale)
    first = triangle.first_under_triangle(centre, scale)
    total = tl.full([BLOCK], 0.0, tl.float32)
    for tap in range(sizes.taps):
        total += triangle.triangle_weight(first + tap, centre, scale)
    light = tl.full([BLOCK], 0.0, tl.float32)
    if BACK:
        light = tl.load(short + value, mask=valid, other=0.0) / total
    for tap in range(sizes.taps):
        weight = triangle.triangle_weight(first + tap, centre, scale)
        pixel = tl.minimum(tl.maximum((first + tap).to(tl.int32), 0), sizes.long - 1)
        at = long + (line * sizes.long + pixel) * sizes.inner + beside
        if BACK:
            tl.atomic_add(at, weight * light, mask=valid & (weight > 0.0))
        else:
            light += weight * tl.load(at, mask=valid, other=0.0)
    if not BACK:
        tl.store(short + value, light / total, mask=valid)
