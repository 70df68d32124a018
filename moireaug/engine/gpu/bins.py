"""The bins of a binned reading: where each lies, and where it looks; and the `Batch` of numbers
that their kernels read."""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl

from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.display import DisplayNumbers
from moireaug.engine.gpu.view import (
    ALPHA,
    SCALE_U,
    SCALE_V,
    jacobian,
    lens_of,
    load32,
    to_image,
    to_photo,
)


class Batch(NamedTuple):
    """A batch's Exposure and Beats; see there.

    Args:
        pixels, lenses, sensors: cameras (B, fields) float64, of photo pixels, of what blurs them
            and of sensor pixels. forward: (B, 9) float64, the inverse of the sensors' homographies.
        enlargement, triangle, ratio: (B,) float32. centres: (B, 3, 2) float64. widths: (B, 3, 2)
            float32. hold: (B,) float32, variance that interpolating the picture adds.
        filters: (B, 3, 3), mean: (B, 3), white: (B, planes) float32.
        coefficients: (B, 3, K, 2) float32. orders: (K, 2) int32.
        harmonic, harmonic_start, alias, alias_start: int32, see `beat_terms.BeatTerms`.
        lost_noise_variance: (B, 2) float32. lost_pattern_variance: (B, 3) float32, see
            `beats.pattern_variance`. flicker: (B, bands) float32. seeds: (B,) int64.
        height, width: of the photo. harmonics, bands: how many orders, and bands of flicker, there
            are.
        display: see there. screen: what is shown. quantiles: see `noise.quantiles`.
    """

    pixels: Any
    lenses: Any
    sensors: Any
    forward: Any
    enlargement: Any
    triangle: Any
    ratio: Any
    centres: Any
    widths: Any
    hold: Any
    filters: Any
    mean: Any
    white: Any
    coefficients: Any
    orders: Any
    harmonic: Any
    harmonic_start: Any
    alias: Any
    alias_start: Any
    lost_noise_variance: Any
    lost_pattern_variance: Any
    flicker: Any
    seeds: Any
    height: int
    width: int
    harmonics: int
    bands: int
    display: DisplayNumbers
    screen: Any = None
    quantiles: Any = None


class Variant(NamedTuple):
    """What a kernel is compiled for, the same of all images of a batch.

    Args:
        period_x, period_y: of the layout, in panel pixels. taps: pixels of the panel that a bin
            sees along each axis.
        rectified: bins lie in the image's frame. bent: the lens distorts. bayer: the sensor has
            colour filters. dark: the panel is black beyond the picture.
        flickers, noisy, clips: see `exposure_records.Exposure`.
    """

    period_x: int
    period_y: int
    taps: int
    rectified: bool
    bent: bool
    bayer: bool
    dark: bool
    flickers: bool
    noisy: bool
    clips: bool


class Bin(NamedTuple):
    """Bins of an image that a program reads.

    Args:
        image: its index, int64. x, y: float64, where their middles look, in panel pixels. u, v:
            float64, where they lie, in photo pixels about the photo's centre.
        step_x, step_y: float32, panel pixels per sensor pixel along u and v.
        first, second: float32, their two sides along u and v, in sensor pixels.
    """

    image: Any
    x: Any
    y: Any
    u: Any
    v: Any
    step_x: Any
    step_y: Any
    first: Any
    second: Any


@triton.jit
def along(step, vector):
    """Return the product of two vectors along u and v."""
    return step[0] * vector[0] + step[1] * vector[1]


@triton.jit
def bins_at(u, v, image, batch, variant: tl.constexpr):
    """Return the Bin at photo points about the photo's centre; in the image's frame, at image
    points about the image's centre."""
    sensor = batch.sensors + image * CAMERA_FIELDS
    half_w, half_h = 0.5 * batch.width, 0.5 * batch.height
    if variant.rectified:
        x, y = u + half_w, v + half_h
        u, v = to_photo(u, v, batch.forward + image * 9, lens_of(sensor), variant.bent)
        u = tl.minimum(tl.maximum(u, -half_w), half_w)  # others are put at the photo's edge
        v = tl.minimum(tl.maximum(v, -half_h), half_h)
    else:
        x, y = to_image(u, v, sensor)
    xu, xv, yu, yv = jacobian(u, v, sensor)
    scale, enlargement = tl.load(sensor + ALPHA), tl.load(batch.enlargement + image)
    if variant.rectified:
        by = scale.to(tl.float32) * enlargement / (xu * yv - xv * yu)
        first, second = (by * yv, -by * yu), (-by * xv, by * xu)
    else:
        none = 0.0 * xu
        first = none + load32(sensor, SCALE_U) * enlargement, none
        second = none, none + load32(sensor, SCALE_V) * enlargement
    return Bin(image, x * scale, y * scale, u, v, (xu, xv), (yu, yv), first, second)
