"""Binned readings: picture to raw, and the gradient in the picture. A program reads BLOCK bins of
one image."""

from __future__ import annotations

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.arrays import CAMERA_FIELDS, NOTHING, camera_field, upload
from moireaug.engine.gpu.beat_terms import BeatTerms, beat_terms, cameras_of, forward
from moireaug.engine.gpu.beats import lost_pattern_variance_kernel, responses
from moireaug.engine.gpu.bins import (
    BinnedBatch,
    BinnedVariant,
    add_content_back,
    bins_at,
    channel_of,
    content,
    patch_of,
)
from moireaug.engine.gpu.panel import show, show_back
from moireaug.engine.gpu.sensor import clipped_mean, flicker, quantiles, reading
from moireaug.engine.gpu.tile import add, black, block
from moireaug.engine.gpu.view import CENTRE_U, CENTRE_V
from moireaug.engine.lower.exposure_records import Beats, BinnedView, Exposure

PULSES_TOP, PULSES_HEIGHT = camera_field("pulses_top"), camera_field("pulses_height")
BLOCK = 128


def expose(picture: Tensor, exposure: Exposure, view: BinnedView) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    batch, variant = _prepare(picture, exposure, view)
    shape = len(picture), len(exposure.sites.channel), *exposure.size
    raw = torch.empty(shape, dtype=torch.float32, device=picture.device)
    expose_kernel[_grid(raw)](raw, batch, variant, BLOCK=BLOCK)
    return raw


def expose_back(grad: Tensor, picture: Tensor, exposure: Exposure, view: BinnedView) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings. Sums are
    not in a fixed order."""
    batch, variant = _prepare(picture, exposure, view)
    light_grad = torch.zeros_like(batch.screen.light)
    expose_back_kernel[_grid(grad)](light_grad, grad.contiguous(), batch, variant, BLOCK=BLOCK)
    return show_back(light_grad, picture, exposure, batch.exposure)


_terms: tuple[Exposure, Beats, BeatTerms] | None = None


def beat_terms_of(exposure: Exposure, beats: Beats) -> BeatTerms:
    """Return the BeatTerms of records, chosen once for those of the last call: `fits`, `expose` and
    `expose_back` ask for the same."""
    global _terms
    last = _terms
    if last is None or last[0] is not exposure or last[1] is not beats:
        _terms = last = exposure, beats, beat_terms(exposure, beats)
    return last[2]


def fits(exposure: Exposure, view: BinnedView) -> np.ndarray:
    """Return for each image whether `expose` can follow its view, (B,) bool."""
    return beat_terms_of(exposure, view.beats).fits


def _prepare(
    picture: Tensor, exposure: Exposure, view: BinnedView
) -> tuple[BinnedBatch, BinnedVariant]:
    """Return what the kernels read of a batch, and what they are compiled for."""
    beats = view.beats
    cameras, harmonics = cameras_of(beats.cameras), len(beats.orders)
    batch = BinnedBatch(
        exposure._replace(cell=NOTHING, sites=NOTHING, budget=NOTHING),
        view.picture._replace(coefficients=NOTHING),
        beats._replace(period=NOTHING, strength=NOTHING),
        beat_terms_of(exposure, beats)._replace(fits=NOTHING),
        forward(cameras),
        np.zeros((len(beats.cameras), 3)),
        harmonics,
        exposure.flicker.shape[1],
    )
    batch = upload(batch, picture.device)
    screen = show(picture, exposure, batch.exposure)
    batch = batch._replace(screen=screen, quantiles=quantiles(picture.device))
    variant = BinnedVariant(
        period_x=int(beats.period[0]),
        period_y=int(beats.period[1]),
        taps=2 * exposure.cell.radius + 1,
        rectified=bool(cameras.rectified.any()),
        sampled=beats.sampled,
        distorts=bool(cameras.k1.any() or cameras.k2.any()),
        bayer=beats.bayer,
        dark_around=exposure.dark_around,
        flickers=batch.bands > 0,
        noisy=exposure.noisy,
        clips=exposure.clips,
    )
    if exposure.clips and beats.saturates and harmonics:
        block, lost = triton.next_power_of_2(harmonics), batch.lost_pattern_variance
        lost_pattern_variance_kernel[(len(lost),)](lost, batch, variant, BLOCK=block)
    return batch, variant


def _grid(raw: Tensor) -> tuple[int]:
    n, _, h, w = raw.shape
    return (n * triton.cdiv(h * w, BLOCK),)


@triton.jit
def bins_of(batch, variant: tl.constexpr, BLOCK: tl.constexpr):
    """Return the Bin of a program, the bins' indices, row by row, and which of them an image
    has."""
    height, width = batch.exposure.size
    image, pixel = block(height * width, BLOCK)
    inside, pixel = pixel < height * width, tl.minimum(pixel, height * width - 1)
    image = image.to(tl.int64)
    camera = batch.exposure.cameras + image * CAMERA_FIELDS
    u = (pixel % width).to(tl.float64) + (0.5 - 0.5 * width + tl.load(camera + CENTRE_U))
    v = (pixel // width).to(tl.float64) + (0.5 - 0.5 * height + tl.load(camera + CENTRE_V))
    return bins_at(u, v, image, batch, variant), pixel, inside


@triton.jit
def contents(bins, batch, variant: tl.constexpr):
    """Return what bins see of the picture, by channel: a tuple."""
    red, green, blue = black(bins.u)
    for channel in range(3):
        shown = channel_of(batch.screen.light, bins.image, channel, batch.screen)
        light = content(shown, patch_of(channel, bins, batch, variant), batch.screen)
        red, green = tl.where(channel == 0, light, red), tl.where(channel == 1, light, green)
        blue = tl.where(channel == 2, light, blue)
    return red, green, blue


@triton.jit
def pulse_at(bins, batch, variant: tl.constexpr):
    """Return the light of the panel's pulses at bins relative to its mean."""
    pulse = 1.0
    if variant.flickers:
        bands, last = batch.exposure.flicker + bins.image * batch.bands, batch.bands - 2
        camera = batch.exposure.cameras + bins.image * CAMERA_FIELDS
        share = (bins.v - tl.load(camera + PULSES_TOP)) / tl.load(camera + PULSES_HEIGHT)
        pulse = flicker(bands, share.to(tl.float32) * last, last)
    return pulse


@triton.jit
def plane_reading(seen, bins, index, batch, PLANE: tl.constexpr, variant: tl.constexpr):
    """Return the readings of bins in one plane, their derivative in the light that they get from
    the panel, and the shares of the picture's red, green and blue in that.

    Args:
        seen: from `contents`, `beats.responses` and `pulse_at`. index: among the image's readings.
    """
    (content, response, pulse), image, exposure = seen, bins.image, batch.exposure
    planes: tl.constexpr = 4 if variant.bayer else 3
    colour: tl.constexpr = (PLANE + 1) // 2 if variant.bayer else PLANE
    light, shares = 0.0 * content[0], ()
    for channel in tl.static_range(3):
        share = tl.load(exposure.filters + (image * 3 + colour) * 3 + channel)
        share *= response[3 * channel + colour]
        light += share * content[channel]
        shares = shares + (share,)
    camera = exposure.cameras + image * CAMERA_FIELDS
    white = tl.load(exposure.white + image * planes + PLANE)
    noise = index, exposure.keys + 2 * image, batch.quantiles
    value, slope = reading(light, pulse, bins.u, bins.v, white, camera, noise, variant.noisy)
    if variant.clips:
        lost = batch.beats.lost_noise_variance + image * 2
        pattern = tl.load(batch.lost_pattern_variance + image * 3 + colour)
        value, by_light = clipped_mean(value, tl.load(lost), tl.load(lost + 1), pattern)
        slope *= by_light
    return value, slope, shares


@triton.jit
def expose_kernel(raw, batch, variant: tl.constexpr, BLOCK: tl.constexpr):
    """Fill raw (B, planes, h, w) with readings."""
    planes: tl.constexpr = 4 if variant.bayer else 3
    bins, pixel, inside = bins_of(batch, variant, BLOCK)
    count = batch.exposure.size[0] * batch.exposure.size[1]
    pulse = pulse_at(bins, batch, variant)
    seen = contents(bins, batch, variant), responses(bins, batch, variant), pulse
    raw += bins.image * planes * count
    for plane in tl.static_range(planes):
        index = plane * count + pixel
        value, _, _ = plane_reading(seen, bins, index, batch, plane, variant)
        tl.store(raw + index, value, mask=inside)


@triton.jit
def expose_back_kernel(light_grad, grad, batch, variant: tl.constexpr, BLOCK: tl.constexpr):
    """Add to light_grad, the gradient in `screen.light`, what comes from that in raw."""
    planes: tl.constexpr = 4 if variant.bayer else 3
    bins, pixel, inside = bins_of(batch, variant, BLOCK)
    count = batch.exposure.size[0] * batch.exposure.size[1]
    pulse = pulse_at(bins, batch, variant)
    seen = contents(bins, batch, variant), responses(bins, batch, variant), pulse
    grad += bins.image * planes * count
    back = black(bins.u)
    for plane in tl.static_range(planes):
        index = plane * count + pixel
        _, slope, shares = plane_reading(seen, bins, index, batch, plane, variant)
        back = add(back, slope * tl.load(grad + index), shares)
    for channel in range(3):
        light = tl.where(channel == 0, back[0], tl.where(channel == 1, back[1], back[2]))
        shown = channel_of(light_grad, bins.image, channel, batch.screen)
        patch = patch_of(channel, bins, batch, variant)
        add_content_back(shown, light, patch, inside, batch.screen)
