"""Full readings, one for each pixel of the sensor, and the gradient in the picture.

A program computes some pixels of one plane of one image. How pixels see a subpixel of the panel's
cell is what exposure methods differ in: a device function `see`, which returns the subpixel's light
on a white picture, and the Patch of pixels shown that the light comes from.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu import point, spectral
from moireaug.engine.gpu.arrays import NOTHING, upload
from moireaug.engine.gpu.panel import show, show_back
from moireaug.engine.gpu.patch import add_content_back, channel_of, content
from moireaug.engine.gpu.random_numbers import quantiles
from moireaug.engine.gpu.sensor_sites import light_passed, look_at_panel, pointers, read, site_of
from moireaug.engine.lower.exposure_records import Exposure, FullView, PointView

WARP = 32  # threads


class FullBatch(NamedTuple):
    """What the kernels read.

    Args:
        subpixels: what the exposure's method reads of them, and subpixel_count.
        raw_shape: planes, height and width of a reading. quantiles: see
            `random_numbers.quantiles`.
    """

    exposure: Exposure
    subpixels: Any
    subpixel_count: int
    raw_shape: tuple[int, int, int]
    screen: Any = None
    quantiles: Any = None


class FullVariant(NamedTuple):
    """What the kernels are compiled for.

    Args:
        span: columns and rows of pixels shown that one sensor pixel sees of a subpixel.
        taps: of the panel's cells along each axis.
        dark_around: the panel is black beyond the picture.
        flickers, noisy, clips: see `exposure_records.Exposure`.
    """

    span: tuple[int, int]
    taps: int
    dark_around: bool
    flickers: bool
    noisy: bool
    clips: bool


def expose(picture: Tensor, exposure: Exposure, view: FullView | PointView) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    batch, constants = _prepare(picture, exposure, view)
    raw = picture.new_empty(len(picture), *batch.raw_shape, dtype=torch.float32)
    expose_kernel[_grid(raw, constants["BLOCK"])](raw, batch, **constants)
    return raw


def expose_back(
    grad: Tensor, picture: Tensor, exposure: Exposure, view: FullView | PointView
) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings."""
    batch, constants = _prepare(picture, exposure, view)
    light_grad = torch.zeros_like(batch.screen.light)
    grid = _grid(grad, constants["BLOCK"])
    expose_back_kernel[grid](light_grad, grad.contiguous(), batch, **constants)
    return show_back(light_grad, picture, exposure, batch.exposure)


def _prepare(
    picture: Tensor, e: Exposure, view: FullView | PointView
) -> tuple[FullBatch, dict[str, Any]]:
    """Return what the kernels read, and what they are compiled with."""
    method: Any = point if isinstance(view, PointView) else spectral
    cell = e.cell._replace(whole=NOTHING, orders=NOTHING, y_group=NOTHING, kind_y_group=NOTHING)
    batch = FullBatch(
        e._replace(cell=cell, budget=NOTHING),
        method.subpixels_of(e, view),
        len(e.cell.channel),
        (
            len(e.sites.channel),
            len(e.sites.rows) // e.sites.step,
            len(e.sites.cols) // e.sites.step,
        ),
    )
    batch = upload(batch, picture.device)
    screen = show(picture, e, batch.exposure)
    batch = batch._replace(screen=screen, quantiles=quantiles(picture.device))
    flickers, taps = e.flicker.shape[1] > 0, 2 * e.cell.radius + 1
    variant = FullVariant(method.span_of(e), taps, e.dark_around, flickers, e.noisy, e.clips)
    constants = {"SEE": method.see, "variant": variant, "BLOCK": method.BLOCK}
    return batch, constants | {"num_warps": method.BLOCK // WARP}  # a thread for each pixel


def _grid(raw: Tensor, block: int) -> tuple[int]:
    images, planes, height, width = raw.shape
    return (images * planes * triton.cdiv(height * width, block),)


@triton.jit
def expose_kernel(raw, batch, SEE: tl.constexpr, variant: tl.constexpr, BLOCK: tl.constexpr):
    """Fill raw (B, planes, h, w), a program for BLOCK pixels of a plane."""
    site = site_of(batch, BLOCK)
    sight, light = look_at_panel(site), 0.0 * site.u.to(tl.float32)
    for i in range(batch.subpixel_count):
        colour, passed = light_passed(i, site, batch.exposure)
        if passed != 0.0:
            subpixel_light, patch = SEE(i, sight, site, batch, variant)
            channel = channel_of(batch.screen.light, site.image, colour, batch.screen)
            light += passed * subpixel_light * content(channel, patch, batch.screen)
    value, _ = read(light, site, batch, variant)
    tl.store(pointers(raw, site, batch), value, mask=site.inside)


@triton.jit
def expose_back_kernel(
    light_grad, grad, batch, SEE: tl.constexpr, variant: tl.constexpr, BLOCK: tl.constexpr
):
    """Add to light_grad, the gradient in `screen.light`, what comes from that in raw."""
    site = site_of(batch, BLOCK)
    sight, light = look_at_panel(site), 0.0 * site.u.to(tl.float32)
    back = light  # the gradient in light, once that is known
    # twice over the subpixels: for their light, on which the slope may depend, and for the gradient
    for turn in range(0 if variant.noisy or variant.clips else 1, 2):
        if turn == 1:
            _, slope = read(light, site, batch, variant)
            back = slope * tl.load(pointers(grad, site, batch))
        for i in range(batch.subpixel_count):
            colour, passed = light_passed(i, site, batch.exposure)
            if passed != 0.0:
                subpixel_light, patch = SEE(i, sight, site, batch, variant)
                subpixel_light *= passed
                if turn == 0:
                    channel = channel_of(batch.screen.light, site.image, colour, batch.screen)
                    light += subpixel_light * content(channel, patch, batch.screen)
                else:
                    channel = channel_of(light_grad, site.image, colour, batch.screen)
                    seen = back * subpixel_light
                    add_content_back(channel, seen, patch, site.inside, batch.screen)
