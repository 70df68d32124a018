"""Binned readings: picture to raw, and the gradient in the picture. A program reads BLOCK bins of
one image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu import display
from moireaug.engine.gpu.arrays import CAMERA_FIELDS, upload
from moireaug.engine.gpu.beats import pattern_variance, responses
from moireaug.engine.gpu.bin_content import Screen, add_content_back, content, views_of
from moireaug.engine.gpu.bins import Batch, Variant, bins_at
from moireaug.engine.gpu.noise import quantiles
from moireaug.engine.gpu.sensor import attenuation, clipped_mean, flicker, noise_of, reflected
from moireaug.engine.lower.beat_terms import beat_terms
from moireaug.engine.lower.exposure_records import Beats, Exposure
from moireaug.engine.lower.views import cameras_of, forward

BLOCK = 128


class Prepared(NamedTuple):
    """What the kernels read of a batch besides its pictures.

    Args:
        batch, variant: see `bins`. shown: see `display.numbers_of`. quantiles: see
            `noise.quantiles`.
    """

    batch: Batch
    variant: Variant
    shown: dict[str, Tensor]
    quantiles: Tensor


def expose(picture: Tensor, exposure: Exposure, beats: Beats) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    prepared = prepare(exposure, beats, picture.device)
    screen = _screen(display.show(picture, exposure, prepared.shown), prepared)
    n, planes = len(picture), len(exposure.sites.channel)
    raw = torch.empty(n, planes, *exposure.size, dtype=torch.float32, device=picture.device)
    batch, variant, _, quantiles = prepared
    _expose[_grid(raw)](raw, screen, batch, quantiles, variant, PLANES=planes, BLOCK=BLOCK)
    return raw


def fits(exposure: Exposure, beats: Beats) -> np.ndarray:
    """Return for each image whether `expose` can follow its view, (B,) bool."""
    return beat_terms(exposure, beats).fits


def expose_back(grad: Tensor, picture: Tensor, exposure: Exposure, beats: Beats) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings. Sums are
    not in a fixed order."""
    prepared = prepare(exposure, beats, picture.device)
    screen = _screen(display.show(picture, exposure, prepared.shown), prepared)
    back = screen._replace(light=torch.zeros_like(screen.light))
    batch, variant, _, quantiles = prepared
    _expose_back[_grid(grad)](
        back, grad.contiguous(), screen, batch, quantiles, variant,
        PLANES=grad.shape[1], BLOCK=BLOCK,
    )  # fmt: skip
    return display.show_back(back.light, picture, exposure, prepared.shown)


def prepare(exposure: Exposure, beats: Beats, device: torch.device) -> Prepared:
    """Return what the kernels read of a batch, on a device."""
    shown, cameras = display.numbers_of(exposure), cameras_of(beats.cameras)
    numbers = upload(shown | _numbers_of(exposure, beats), device)
    (h, w), harmonics, bands = exposure.size, len(beats.orders), exposure.flicker.shape[1]
    lost = torch.zeros(len(beats.cameras), 3, dtype=torch.float32, device=device)
    sizes = {"height": h, "width": w, "harmonics": harmonics, "bands": bands}
    pointers = {name: numbers[name] for name in Batch._fields if name in numbers}
    batch = Batch(**pointers, lost_pattern_variance=lost, **sizes)
    variant = Variant(
        period_x=int(beats.period[0]),
        period_y=int(beats.period[1]),
        taps=2 * exposure.cell.radius + 1,
        rectified=bool(cameras.rectified.any()),
        bent=bool(cameras.k1.any() or cameras.k2.any()),
        bayer=beats.bayer,
        dark=exposure.dark,
        flickers=bands > 0,
        noisy=exposure.noisy,
        clips=exposure.clips,
    )
    if exposure.clips and beats.saturates and harmonics:
        block = triton.next_power_of_2(harmonics)
        pattern_variance[(len(lost),)](lost, batch, variant, BLOCK=block)
    return Prepared(batch, variant, {name: numbers[name] for name in shown}, quantiles(device))


def _numbers_of(e: Exposure, b: Beats) -> dict[str, np.ndarray]:
    """Return the arrays that a `Batch` points to."""
    terms = beat_terms(e, b)
    whole = {
        "orders": b.orders,
        "harmonic": terms.harmonic,
        "harmonic_start": terms.harmonic_start,
        "alias": terms.alias,
        "alias_start": terms.alias_start,
    }
    single = {
        "enlargement": b.enlargement,
        "triangle": b.triangle,
        "ratio": b.ratio,
        "widths": e.widths,
        "hold": e.added_variance[:, 0, 0],
        "filters": e.filters,
        "mean": b.mean,
        "white": e.white,
        "coefficients": b.coefficients,
        "lost_noise_variance": b.lost_noise_variance,
        "flicker": e.flicker,
    }
    return {
        "pixels": e.cameras,
        "lenses": e.lenses,
        "sensors": b.cameras,
        "forward": forward(cameras_of(b.cameras)),
        "centres": b.centres,
        "seeds": e.seeds,
        **{name: array.astype(np.float32) for name, array in single.items()},
        **{name: array.astype(np.int32) for name, array in whole.items()},
    }


def _screen(shown: display.Shown, prepared: Prepared) -> Screen:
    light, lead = shown
    rows, columns = light.shape[2:]
    return Screen(light, rows, columns, lead, prepared.shown["pixel_scale"])


def _grid(raw: Tensor) -> tuple[int, int]:
    n, _, h, w = raw.shape
    return triton.cdiv(h * w, BLOCK), n


@triton.jit
def bins_of(pixel, image, batch, variant: tl.constexpr):
    """Return the Bin of an image's pixels, numbered row by row."""
    row, col = pixel // batch.width, pixel % batch.width
    u, v = col.to(tl.float64) + 0.5 - 0.5 * batch.width, row.to(tl.float64) + 0.5
    return bins_at(u, v - 0.5 * batch.height, image, batch, variant)


@triton.jit
def reading_of(
    light, pulse, bins, number, image, batch, quantiles, PLANE: tl.constexpr, variant: tl.constexpr
):
    """Return the readings of bins in one plane, and their derivative in the light that they get
    from the panel.

    Args:
        light: without flicker. pulse: of the flicker. number: of each among the image's readings.
        colour: of the plane.
    """
    camera = batch.pixels + image * CAMERA_FIELDS
    planes: tl.constexpr = 4 if variant.bayer else 3
    colour: tl.constexpr = (PLANE + 1) // 2 if variant.bayer else PLANE
    u, v = bins.u.to(tl.float32), bins.v.to(tl.float32)
    white, factor = tl.load(batch.white + image * planes + PLANE), attenuation(u, v, camera)
    light = (light * pulse + white * reflected(u, v, camera)) * factor
    slope = pulse * factor
    if variant.noisy:
        noise, by_light = noise_of(light, number, tl.load(batch.seeds + image), camera, quantiles)
        light, slope = light + noise, slope * (1.0 + by_light)
    if variant.clips:
        lost = batch.lost_noise_variance + image * 2
        pattern = tl.load(batch.lost_pattern_variance + image * 3 + colour)
        light, by_light = clipped_mean(light, tl.load(lost), tl.load(lost + 1), pattern)
        slope *= by_light
    return light, slope


@triton.jit
def pulse_at(bins, image, batch, variant: tl.constexpr):
    """Return the light of the panel's pulses at bins relative to its mean."""
    pulse = 0.0 * bins.xu + 1.0
    if variant.flickers:
        bands, last = batch.flicker + image * batch.bands, batch.bands - 2
        share = bins.v.to(tl.float32) / batch.height + 0.5
        pulse = flicker(bands, share * last, last)
    return pulse


@triton.jit
def passed_by(response, image, batch, PLANE: tl.constexpr, variant: tl.constexpr):
    """Return what a plane reads of the picture's red, green and blue light, a tuple; response: from
    `beats.responses`."""
    colour: tl.constexpr = (PLANE + 1) // 2 if variant.bayer else PLANE
    shares = ()
    for channel in tl.static_range(3):
        share = tl.load(batch.filters + (image * 3 + colour) * 3 + channel)
        shares = shares + (share * response[3 * channel + colour],)
    return shares


@triton.jit
def contents(bins, image, batch, screen, valid, variant: tl.constexpr):
    """Return what bins see of the picture, by channel: a tuple."""
    red, green, blue = 0.0 * bins.xu, 0.0 * bins.xu, 0.0 * bins.xu
    for channel in range(3):
        x, y = views_of(channel, image, bins, batch, screen, variant)
        light = content(channel, image, x, y, screen, valid, variant)
        red, green = tl.where(channel == 0, light, red), tl.where(channel == 1, light, green)
        blue = tl.where(channel == 2, light, blue)
    return red, green, blue


@triton.jit
def _expose(
    raw, screen, batch, quantiles, variant: tl.constexpr, PLANES: tl.constexpr, BLOCK: tl.constexpr
):
    """Fill raw (B, planes, h, w) with readings."""
    image, pixel = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    pixels = batch.height * batch.width
    valid, bins = pixel < pixels, bins_of(pixel, image, batch, variant)
    picture = contents(bins, image, batch, screen, valid, variant)
    response, pulse = responses(bins, image, batch, variant), pulse_at(bins, image, batch, variant)
    raw += image.to(tl.int64) * PLANES * pixels
    for plane in tl.static_range(PLANES):
        share = passed_by(response, image, batch, plane, variant)
        light = picture[0] * share[0] + picture[1] * share[1] + picture[2] * share[2]
        number = plane * pixels + pixel
        reading, _ = reading_of(light, pulse, bins, number, image, batch, quantiles, plane, variant)
        tl.store(raw + number, reading, mask=valid)


@triton.jit
def _expose_back(
    back, grad, screen, batch, quantiles, variant: tl.constexpr, PLANES: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Add to back, a Screen, the gradient in what is shown, from that in the readings."""
    image, pixel = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    pixels = batch.height * batch.width
    valid, bins = pixel < pixels, bins_of(pixel, image, batch, variant)
    picture = contents(bins, image, batch, screen, valid, variant)
    response, pulse = responses(bins, image, batch, variant), pulse_at(bins, image, batch, variant)
    grad += image.to(tl.int64) * PLANES * pixels
    red, green, blue = 0.0 * bins.xu, 0.0 * bins.xu, 0.0 * bins.xu
    for plane in tl.static_range(PLANES):
        share = passed_by(response, image, batch, plane, variant)
        light = picture[0] * share[0] + picture[1] * share[1] + picture[2] * share[2]
        number = plane * pixels + pixel
        _, slope = reading_of(light, pulse, bins, number, image, batch, quantiles, plane, variant)
        slope *= tl.load(grad + number, mask=valid, other=0.0)
        red, green, blue = red + slope * share[0], green + slope * share[1], blue + slope * share[2]
    for channel in range(3):
        x, y = views_of(channel, image, bins, batch, screen, variant)
        light = tl.where(channel == 0, red, tl.where(channel == 1, green, blue))
        add_content_back(light, channel, image, x, y, back, valid, variant)
