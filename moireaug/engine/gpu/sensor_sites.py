"""The sensor's pixels in a full reading: where they lie, where they look, and what they read of the
panel's light."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl

from moireaug.engine.exposure_records import Camera, Exposure
from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.sensor import reading
from moireaug.engine.gpu.tile import block
from moireaug.engine.gpu.view import ALPHA, jacobian, to_image


class SensorNumbers(NamedTuple):
    """The numbers of a full reading; see `exposure_records.Exposure`.

    Args:
        rows, cols, step: see `exposure_records.Sites`. site_row, site_col, channel: (planes,)
            int32, likewise.
        filters, white, flicker: float32. shown_scale: (B,) float64, pixels shown per panel pixel.
        planes, height, width: of a raw reading.
    """

    cameras: Any
    rows: Any
    cols: Any
    site_row: Any
    site_col: Any
    channel: Any
    filters: Any
    white: Any
    flicker: Any
    seeds: Any
    shown_scale: Any
    step: int
    planes: int
    height: int
    width: int


class Site(NamedTuple):
    """Pixels of one plane of an image that a program reads.

    Args:
        image, plane: their indices. camera: pointer to the image's Camera. pixel: (n,) int32, among
            the plane's, row by row. inside: whether it is one; else it is the last, again.
        u, v: float64, where they lie on the photo. row: of the sensor.
    """

    image: Any
    plane: Any
    camera: Any
    pixel: Any
    inside: Any
    u: Any
    v: Any
    row: Any


def sensor_numbers(e: Exposure) -> SensorNumbers:
    """Return the SensorNumbers of an exposure, of arrays."""
    sites = e.sites
    return SensorNumbers(
        cameras=e.cameras,
        rows=sites.rows,
        cols=sites.cols,
        site_row=sites.row.astype(np.int32),
        site_col=sites.col.astype(np.int32),
        channel=sites.channel.astype(np.int32),
        filters=e.filters.astype(np.float32),
        white=e.white.astype(np.float32),
        flicker=e.flicker.astype(np.float32),
        seeds=e.seeds,
        shown_scale=1 / np.maximum(e.cameras[:, Camera._fields.index("alpha")], 1),
        step=sites.step,
        planes=len(sites.channel),
        height=len(sites.rows) // sites.step,
        width=len(sites.cols) // sites.step,
    )


@triton.jit
def site_of(sensor, BLOCK: tl.constexpr):
    """Return the Site of a program, and where its pixels are in raw (B, planes, h, w)."""
    count = sensor.height * sensor.width
    group, pixel = block(count, BLOCK)
    image, plane = group // sensor.planes, group % sensor.planes
    inside, pixel = pixel < count, tl.minimum(pixel, count - 1)
    row = pixel // sensor.width * sensor.step + tl.load(sensor.site_row + plane)
    col = pixel % sensor.width * sensor.step + tl.load(sensor.site_col + plane)
    u, v = tl.load(sensor.cols + col), tl.load(sensor.rows + row)
    camera = sensor.cameras + image * CAMERA_FIELDS
    return Site(image, plane, camera, pixel, inside, u, v, row), group * count + pixel


@triton.jit
def look_at_panel(site):
    """Return which panel coordinates x and y pixels see, float64, each with its change per sensor
    pixel along u and v, float32."""
    x, y = to_image(site.u, site.v, site.camera)
    alpha = tl.load(site.camera + ALPHA)
    xu, xv, yu, yv = jacobian(site.u, site.v, site.camera)
    return (x * alpha, (xu, xv)), (y * alpha, (yu, yv))


@triton.jit
def read(light, site, sensor, quantiles, variant: tl.constexpr):
    """Return the readings of pixels that see this light of the panel, and their slopes in it."""
    pulse = 1.0
    if variant.flickers:
        rows = sensor.height * sensor.step
        pulse = tl.load(sensor.flicker + site.image * rows + site.row)
    white = tl.load(sensor.white + site.image * sensor.planes + site.plane)
    index = (site.plane * sensor.height * sensor.width).to(tl.int32) + site.pixel
    noise = index, tl.load(sensor.seeds + site.image), quantiles
    value, slope = reading(light, pulse, site.u, site.v, white, site.camera, noise, variant.noisy)
    if variant.clips:
        slope = tl.where((value < 0.0) | (value > 1.0), 0.0, slope)
        value = tl.minimum(tl.maximum(value, 0.0), 1.0)
    return value, slope


@triton.jit
def light_passed(i, site, sensor, subpixels):
    """Return the colour of subpixel i, and the share of its light that a plane's filter passes."""
    colour, channel = tl.load(subpixels.colour + i), tl.load(sensor.channel + site.plane)
    return colour, tl.load(sensor.filters + (site.image * 3 + channel) * 3 + colour)
