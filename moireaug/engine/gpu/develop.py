"""Binned readings to photos, and the gradient on the way back.

One kernel computes a photo from its reading, whose pixels are the photo's. Where detail is
filtered, two more follow (see `detail`). On the way back, what developing left in between is
computed again.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.detail import filter_detail, filter_detail_back
from moireaug.engine.gpu.develop_arrays import CodesVariant, develop_arrays
from moireaug.engine.gpu.tile import address, launch, load, store, tile
from moireaug.engine.gpu.tone import codes, codes_back, tone_of
from moireaug.engine.lower.development_records import Development


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
