"""Readings to photos, and the gradient on the way back.

One kernel computes a photo from its reading. Where detail is filtered, it computes the codes of
every sensor pixel, of which two more make a photo (see `detail`); where the photo is brought back
to the image's frame, one more does so (see `register`).

The gradient has gather form: each pixel's is a sum over the pixels that it contributes to, always
in the same order. What developing left in between is computed again.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.demosaic import demosaic_back_kernel, sensor_colours, store_reading_grad
from moireaug.engine.gpu.detail import filter_detail, filter_detail_back
from moireaug.engine.gpu.develop_arrays import CodesArrays, CodesVariant, develop_arrays
from moireaug.engine.gpu.register import register, register_back
from moireaug.engine.gpu.resize import resize_back, resized
from moireaug.engine.gpu.tile import launch, store, tile
from moireaug.engine.gpu.tone import codes, codes_back, tone_of
from moireaug.engine.lower.development_records import Development


@triton.jit
def sensor_codes(source, pixels):
    """Return the codes of Pixels of the sensor, as `resize.resized` takes them."""
    raw, tone, variant = source
    return codes(sensor_colours(raw, pixels, variant), tone, variant)


@triton.jit
def develop_kernel(photo, raw, arrays, variant: tl.constexpr, TILE: tl.constexpr):
    """Fill photo (B, 3, H, W) from raw: means of sensor pixels' codes; arrays, variant: see
    `develop_arrays`."""
    pixels = tile(photo, TILE)
    source = raw, tone_of(arrays.tones, pixels.image), variant
    store(photo, pixels, resized(sensor_codes, source, pixels, arrays.rows, arrays.cols))


@triton.jit
def light_back_kernel(out, grad, raw, arrays, variant: tl.constexpr, TILE: tl.constexpr):
    """Fill out with the gradient in raw, (B, planes, ...), or before a demosaic in the light of
    every sensor pixel, (B, 3, ...), from grad (B, 3, H, W). The rest as in `develop_kernel`."""
    pixels = tile(out, TILE)
    code_grads = resize_back(grad, pixels, arrays.rows, arrays.cols)
    tone, light = tone_of(arrays.tones, pixels.image), sensor_colours(raw, pixels, variant)
    grads = codes_back(code_grads, light, tone, variant)
    if len(variant.taps) > 0:
        store(out, pixels, grads)
    elif variant.planes == 3:
        for plane in tl.static_range(3):
            store_reading_grad(out, raw, plane, pixels, grads[plane], variant)
    else:
        store_reading_grad(out, raw, 0, pixels, grads[0], variant)
        store_reading_grad(out, raw, 1, pixels, 0.5 * grads[1], variant)
        store_reading_grad(out, raw, 2, pixels, 0.5 * grads[1], variant)
        store_reading_grad(out, raw, 3, pixels, grads[2], variant)


def _codes_of(raw: Tensor, arrays: CodesArrays, variant: CodesVariant) -> Tensor:
    """Return the codes (B, 3, h, w) of readings, resized, in the camera's frame."""
    photo = raw.new_empty(len(raw), 3, arrays.rows.photo_size, arrays.cols.photo_size)
    launch(develop_kernel, photo, raw, arrays, variant=variant)
    return photo


def _codes_back(grad: Tensor, raw: Tensor, arrays: CodesArrays, variant: CodesVariant) -> Tensor:
    """Return the gradient in readings, from that in their codes."""
    raw_grad = torch.empty_like(raw)
    if not variant.taps:
        launch(light_back_kernel, raw_grad, grad, raw, arrays, variant=variant)
        return raw_grad
    light_grad = raw.new_empty(len(raw), 3, arrays.rows.size, arrays.cols.size)
    launch(light_back_kernel, light_grad, grad, raw, arrays, variant=variant)
    launch(demosaic_back_kernel, raw_grad, light_grad, raw, variant=variant)
    return raw_grad


def develop(raw: Tensor, development: Development) -> Tensor:
    """Return the photos (B, 3, H, W) float32 of readings (B, planes, h, w) float32."""
    arrays, variant = develop_arrays(development, raw.device)
    photo = _codes_of(raw.contiguous(), arrays.codes, variant)
    if arrays.detail is not None:
        photo = filter_detail(photo, arrays.detail)
    if arrays.registration is not None:
        photo = register(photo, arrays.registration)
    return photo


def develop_back(grad: Tensor, raw: Tensor, development: Development) -> Tensor:
    """Return the gradient in readings (B, planes, h, w), from that in photos (B, 3, H, W)."""
    arrays, variant = develop_arrays(development, raw.device)
    raw, grad = raw.contiguous(), grad.contiguous()
    if arrays.registration is not None:
        grad = register_back(grad, arrays.registration)
    if arrays.detail is not None:
        grad = filter_detail_back(grad, _codes_of(raw, arrays.codes, variant), arrays.detail)
    return _codes_back(grad, raw, arrays.codes, variant)
