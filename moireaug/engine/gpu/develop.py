"""Binned readings to photos, and the gradient on the way back.

One kernel computes a photo from its reading, whose pixels are the photo's. Where detail is
filtered, two more follow (see `detail`). On the way back, what developing left in between is
computed again.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.arrays import upload
from moireaug.engine.gpu.detail import (
    DetailArrays,
    detail_arrays,
    filter_detail,
    filter_detail_back,
)
from moireaug.engine.gpu.physics import encoding
from moireaug.engine.gpu.physics import tone as curve
from moireaug.engine.gpu.tile import address, clip, clip_back, launch, load, store, tile
from moireaug.engine.lower.development_records import Development


class CodesVariant(NamedTuple):
    """What kernels that make codes of readings are compiled with.

    Args:
        planes: of the readings.
        saturates, coded, toned: see `development_records.Codes`.
    """

    planes: int
    saturates: bool
    coded: bool
    toned: bool


class DevelopArrays(NamedTuple):
    """A batch's development.

    Args:
        tones: (B, 12) float32, of each image the colour matrix, row by row, shoulder, contrast and
            brightness; see `development_records.Codes`.
        detail: None if none is filtered.
    """

    tones: Any
    detail: DetailArrays | None


def develop_arrays(d: Development, device: torch.device) -> tuple[DevelopArrays, CodesVariant]:
    """Return a Development on a device, and the CodesVariant of its codes."""
    c, detail = d.codes, detail_arrays(d.detail) if d.filters_detail else None
    tones = np.column_stack([c.matrix.reshape(-1, 9), c.shoulder, c.contrast, c.brighten])
    variant = CodesVariant(c.planes, c.saturates, c.coded, c.toned)
    return upload(DevelopArrays(tones, detail), device), variant


class Tone(NamedTuple):
    """An image's colours: what codes are made with besides its light; see
    `development_records.Codes`.

    Args:
        matrix: three rows of three.
    """

    matrix: Any
    shoulder: Any
    contrast: Any
    brighten: Any


@triton.jit
def tone_of(tones, image):
    """Return an image's Tone, as laid out by `develop_arrays`."""
    at = tones + image * 12
    matrix = (
        (tl.load(at), tl.load(at + 1), tl.load(at + 2)),
        (tl.load(at + 3), tl.load(at + 4), tl.load(at + 5)),
        (tl.load(at + 6), tl.load(at + 7), tl.load(at + 8)),
    )
    return Tone(matrix, tl.load(at + 9), tl.load(at + 10), tl.load(at + 11))


@triton.jit
def mix(colours, matrix):
    """Return colours times a matrix."""
    red, green, blue = colours
    return [row[0] * red + row[1] * green + row[2] * blue for row in matrix]


@triton.jit
def code(light, tone, variant: tl.constexpr):
    """Return the code of one colour's light, in [0, 1], and its derivative."""
    x, slope = light, tl.full(light.shape, 1.0, tl.float32)
    if variant.coded:
        x, slope = encoding.code_of_light(light), encoding.code_slope(light)
    if variant.toned:
        slope = clip_back(slope, x)
        x = clip(x)
        x, steepness = curve.shoulder_and_slope(x, tone.shoulder)
        slope *= steepness * curve.contrast_slope(x, tone.contrast)
        x = curve.contrast_curve(x, tone.contrast)
    x += tone.brighten
    return clip(x), clip_back(slope, x)


@triton.jit
def codes(colours, tone, variant: tl.constexpr):
    """Return the codes of a pixel's colours, as the sensor has them; variant: see
    `CodesVariant`."""
    return [code(light, tone, variant)[0] for light in mix(colours, tone.matrix)]


@triton.jit
def codes_back(grad, colours, tone, variant: tl.constexpr):
    """Return the gradient in a pixel's colours, as the sensor has them, from that in its codes."""
    slopes = [code(light, tone, variant)[1] for light in mix(colours, tone.matrix)]
    red, green, blue = grad[0] * slopes[0], grad[1] * slopes[1], grad[2] * slopes[2]
    matrix = tone.matrix
    return (
        matrix[0][0] * red + matrix[1][0] * green + matrix[2][0] * blue,
        matrix[0][1] * red + matrix[1][1] * green + matrix[2][1] * blue,
        matrix[0][2] * red + matrix[1][2] * green + matrix[2][2] * blue,
    )


@triton.jit
def reading_of(raw, plane, pixels, variant: tl.constexpr):
    """Return readings of a plane."""
    at = address(raw, pixels, variant.planes) + plane * raw.height * raw.width
    return tl.load(at, mask=pixels.exist, other=0.0)


@triton.jit
def colours_of(raw, pixels, variant: tl.constexpr):
    """Return red, green and blue light of readings, saturated: of three planes, which are colours,
    or of four, R, G, G and B, whose greens are averaged."""
    red, green = reading_of(raw, 0, pixels, variant), reading_of(raw, 1, pixels, variant)
    blue = reading_of(raw, variant.planes - 1, pixels, variant)
    if variant.saturates:
        red, green, blue = tl.minimum(red, 1.0), tl.minimum(green, 1.0), tl.minimum(blue, 1.0)
    if variant.planes == 4:
        other = reading_of(raw, 2, pixels, variant)
        if variant.saturates:
            other = tl.minimum(other, 1.0)
        green = 0.5 * (green + other)
    return red, green, blue


@triton.jit
def store_grad(raw_grad, raw, plane, pixels, grad, variant: tl.constexpr):
    """Store the gradient in readings of a plane, from that in their colour."""
    if variant.saturates:
        grad = tl.where(reading_of(raw, plane, pixels, variant) <= 1.0, grad, 0.0)
    at = address(raw_grad, pixels, variant.planes) + plane * raw.height * raw.width
    tl.store(at, grad, mask=pixels.exist)


@triton.jit
def develop_kernel(photo, raw, tones, variant: tl.constexpr, TILE: tl.constexpr):
    """Fill photo (B, 3, H, W) with the codes of raw (B, planes, H, W); tones, variant: see
    `develop_arrays`."""
    pixels = tile(photo, TILE)
    tone = tone_of(tones, pixels.image)
    store(photo, pixels, codes(colours_of(raw, pixels, variant), tone, variant))


@triton.jit
def develop_back_kernel(raw_grad, grad, raw, tones, variant: tl.constexpr, TILE: tl.constexpr):
    """Fill raw_grad with the gradient in raw, from grad (B, 3, H, W); the rest as in
    `develop_kernel`."""
    pixels = tile(raw_grad, TILE)
    light, tone = colours_of(raw, pixels, variant), tone_of(tones, pixels.image)
    red, green, blue = codes_back(load(grad, pixels), light, tone, variant)
    store_grad(raw_grad, raw, 0, pixels, red, variant)
    if variant.planes == 4:
        green *= 0.5
        store_grad(raw_grad, raw, 2, pixels, green, variant)
    store_grad(raw_grad, raw, 1, pixels, green, variant)
    store_grad(raw_grad, raw, variant.planes - 1, pixels, blue, variant)


def _codes_of(raw: Tensor, tones: Tensor, variant: CodesVariant) -> Tensor:
    """Return the codes (B, 3, H, W) of readings (B, planes, H, W)."""
    out = raw.new_empty(len(raw), 3, *raw.shape[2:])
    launch(develop_kernel, out, raw, tones=tones, variant=variant)
    return out


def develop(raw: Tensor, development: Development) -> Tensor:
    """Return the photos (B, 3, H, W) float32 of readings (B, planes, H, W) float32."""
    arrays, variant = develop_arrays(development, raw.device)
    photo = _codes_of(raw.contiguous(), arrays.tones, variant)
    return photo if arrays.detail is None else filter_detail(photo, arrays.detail)


def develop_back(grad: Tensor, raw: Tensor, development: Development) -> Tensor:
    """Return the gradient in readings (B, planes, H, W), from that in photos (B, 3, H, W)."""
    arrays, variant = develop_arrays(development, raw.device)
    raw, grad = raw.contiguous(), grad.contiguous()
    if arrays.detail is not None:
        grad = filter_detail_back(grad, _codes_of(raw, arrays.tones, variant), arrays.detail)
    out = torch.empty_like(raw)
    launch(develop_back_kernel, out, grad, raw, tones=arrays.tones, variant=variant)
    return out
