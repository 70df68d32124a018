"""The sensor's pixels in a full reading: where they lie, where they look, and what they read of the
panel's light."""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.sensor import reading
from moireaug.engine.gpu.tile import block
from moireaug.engine.gpu.view import ALPHA, jacobian, to_image


class Site(NamedTuple):
    """Pixels of one plane of an image that a program reads.

    Args:
        image, plane: their indices. camera: pointer to the image's Camera. pixel: (n,) int32, among
            the plane's, row by row. inside: whether it is one; else it is the last, again.
        u, v: float64, where they lie on the photo. row: of the sensor.
        shown_scale: float64, pixels shown per panel pixel.
    """

    image: Any
    plane: Any
    camera: Any
    pixel: Any
    inside: Any
    u: Any
    v: Any
    row: Any
    shown_scale: Any


@triton.jit
def site_of(batch, BLOCK: tl.constexpr):
    """Return the Site of a program."""
    sites, (planes, height, width) = batch.exposure.sites, batch.raw_shape
    group, pixel = block(height * width, BLOCK)
    image, plane = (group // planes).to(tl.int64), group % planes
    inside, pixel = pixel < height * width, tl.minimum(pixel, height * width - 1)
    row = pixel // width * sites.step + tl.load(sites.row + plane)
    col = pixel % width * sites.step + tl.load(sites.col + plane)
    u, v = tl.load(sites.cols + col), tl.load(sites.rows + row)
    camera = batch.exposure.cameras + image * CAMERA_FIELDS
    shown_scale = 1.0 / tl.maximum(tl.load(camera + ALPHA), 1.0)
    return Site(image, plane, camera, pixel, inside, u, v, row, shown_scale)


@triton.jit
def pointers(raw, site, batch):
    """Return pointers to the pixels of a Site in raw (B, planes, h, w)."""
    planes, height, width = batch.raw_shape
    return raw + (site.image * planes + site.plane) * height * width + site.pixel


@triton.jit
def look_at_panel(site):
    """Return which panel coordinates x and y pixels see, float64, each with its change per sensor
    pixel along u and v, float32."""
    x, y = to_image(site.u, site.v, site.camera)
    alpha = tl.load(site.camera + ALPHA)
    xu, xv, yu, yv = jacobian(site.u, site.v, site.camera)
    return (x * alpha, (xu, xv)), (y * alpha, (yu, yv))


@triton.jit
def read(light, site, batch, variant: tl.constexpr):
    """Return the readings of pixels that see this light of the panel, and their slopes in it."""
    exposure, (planes, height, width), pulse = batch.exposure, batch.raw_shape, 1.0
    if variant.flickers:
        rows = height * exposure.sites.step
        pulse = tl.load(exposure.flicker + site.image * rows + site.row)
    white = tl.load(exposure.white + site.image * planes + site.plane)
    index = site.plane * height * width + site.pixel
    noise = index, exposure.keys + 2 * site.image, batch.quantiles
    value, slope = reading(light, pulse, site.u, site.v, white, site.camera, noise, variant.noisy)
    if variant.clips:
        slope = tl.where((value < 0.0) | (value > 1.0), 0.0, slope)
        value = tl.minimum(tl.maximum(value, 0.0), 1.0)
    return value, slope


@triton.jit
def light_passed(i, site, exposure):
    """Return the colour of subpixel i, and the share of its light that a plane's filter passes."""
    colour = tl.load(exposure.cell.channel + i)
    channel = tl.load(exposure.sites.channel + site.plane)
    return colour, tl.load(exposure.filters + (site.image * 3 + channel) * 3 + colour)
