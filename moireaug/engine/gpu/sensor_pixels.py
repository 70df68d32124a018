"""The sensor's pixels in a full reading: where they lie, where they look, and what they read of the
panel's light."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.sensor import attenuation, noise_of, reflected
from moireaug.engine.gpu.view import ALPHA, jacobian, to_image
from moireaug.engine.lower.exposure_records import Camera, Exposure


class Reading(NamedTuple):
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


def reading_of(e: Exposure) -> Reading:
    """Return the Reading of an exposure, of arrays."""
    sites = e.sites
    return Reading(
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
def place_of(pixel, plane, reading):
    """Return where the pixels of a plane lie on the photo, u and v float64, and their sensor
    rows."""
    row = pixel // reading.width * reading.step + tl.load(reading.site_row + plane)
    column = pixel % reading.width * reading.step + tl.load(reading.site_col + plane)
    return tl.load(reading.cols + column), tl.load(reading.rows + row), row


@triton.jit
def look_at_panel(u, v, image, reading):
    """Return which panel coordinates photo points see, float64; and the change of each along u and
    v per sensor pixel, float32."""
    camera = reading.cameras + image * CAMERA_FIELDS
    x, y = to_image(u, v, camera)
    alpha = tl.load(camera + ALPHA)
    xu, xv, yu, yv = jacobian(u, v, camera)
    return (x * alpha, y * alpha), (xu, yu), (xv, yv)


@triton.jit
def read(
    light, u, v, pixel, plane, image, reading, quantiles, NOISY: tl.constexpr, CLIPS: tl.constexpr
):
    """Return the readings of pixels that see this light of the panel, and their slopes in it.

    NOISY, CLIPS: see `exposure_records.Exposure`.
    """
    camera = reading.cameras + image * CAMERA_FIELDS
    u, v = u.to(tl.float32), v.to(tl.float32)
    white = tl.load(reading.white + image * reading.planes + plane)
    slope = attenuation(u, v, camera)
    value = slope * (light + white * reflected(u, v, camera))
    if NOISY:
        number = plane * reading.height * reading.width + pixel
        seed = tl.load(reading.seeds + image)
        noise, growth = noise_of(value, number, seed, camera, quantiles)
        value, slope = value + noise, slope * (1.0 + growth)
    if CLIPS:
        slope = tl.where((value < 0.0) | (value > 1.0), 0.0, slope)
        value = tl.minimum(tl.maximum(value, 0.0), 1.0)
    return value, slope


@triton.jit
def light_passed(i, plane, image, subpixels, reading):
    """Return the colour of subpixel i, and the share of its light that a plane's filter passes."""
    colour, channel = tl.load(subpixels.colour + i), tl.load(reading.channel + plane)
    return colour, tl.load(reading.filters + (image * 3 + channel) * 3 + colour)


@triton.jit
def pulse_at(row, image, reading, FLICKERS: tl.constexpr):
    """Return the panel's light while sensor rows are exposed, relative to its mean."""
    pulse = 1.0
    if FLICKERS:
        pulse = tl.load(reading.flicker + image * reading.height * reading.step + row)
    return pulse
