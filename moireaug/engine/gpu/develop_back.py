"""The gradient in readings, from that in photos, in gather form: each pixel's is a sum over the
pixels that it contributes to, always in the same order.

One kernel computes it where each pixel of the planes is one of the photo; before a demosaic, its
result is the gradient in every sensor pixel's light, from which one more gathers that in readings.
What developing left in between is computed again.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.demosaic import colours, demosaic_back
from moireaug.engine.gpu.detail import filter_detail_back
from moireaug.engine.gpu.develop import codes_of
from moireaug.engine.gpu.develop_arrays import CodesArrays, develop_arrays
from moireaug.engine.gpu.registration_back import register_back
from moireaug.engine.gpu.resize import resize_back
from moireaug.engine.gpu.tile import launch, size_of, store_colours, tile
from moireaug.engine.gpu.tone import codes_back, look_of
from moireaug.engine.lower.development_records import Development


@triton.jit
def store_readings(
    raw_grad, raw, row, col, size, inside, grad, PLANES: tl.constexpr, SATURATES: tl.constexpr
):
    """Store the gradient in readings of an image's planes (PLANES, *size) from that in colours."""
    at = row * size[1] + col
    for plane in tl.static_range(PLANES):
        if PLANES == 4:  # the greens are averaged
            value = (grad[0], grad[1] * 0.5, grad[1] * 0.5, grad[2])[plane]
        else:
            value = grad[plane]
        if SATURATES:
            value = tl.where(tl.load(raw + at, mask=inside, other=0.0) <= 1.0, value, 0.0)
        tl.store(raw_grad + at, value, mask=inside)
        at += size[0] * size[1]


@triton.jit
def light_back_kernel(
    out,
    grad,
    raw,
    looks,
    rows,
    cols,
    size,
    raw_size,
    PLANES: tl.constexpr,
    DEMOSAIC: tl.constexpr,
    STEP: tl.constexpr,
    SATURATES: tl.constexpr,
    LEVELS: tl.constexpr,
    CODED: tl.constexpr,
    TONED: tl.constexpr,
    ROWS: tl.constexpr,
    COLS: tl.constexpr,
):
    """Fill out with the gradient in raw (B, PLANES, *raw_size), or before a demosaic in the light
    of every sensor pixel, (B, 3, ...), from grad (B, 3, *size). The rest as in `develop_kernel`."""
    height, width = raw_size
    image, row, col, inside = tile((height * STEP, width * STEP), ROWS, COLS)
    raw += image * PLANES * height * width
    grad += image * 3 * size[0] * size[1]
    look = look_of(looks, image)
    r, g, b = colours(raw, row, col, raw_size, inside, PLANES, DEMOSAIC, SATURATES, LEVELS)
    code_grads = resize_back(grad, row, col, size, rows, cols, inside)
    red, green, blue = codes_back(code_grads, r, g, b, look, CODED, TONED)
    if STEP == 1:
        out += image * PLANES * height * width
        grads = (red, green, blue)
        store_readings(out, raw, row, col, raw_size, inside, grads, PLANES, SATURATES)
    else:
        sensor_size = (height * STEP, width * STEP)
        store_colours(out, image, row, col, sensor_size, inside, red, green, blue)


@triton.jit
def most_copies(first, count, end):
    """Return at how many places the demosaic reads a cell of a row (or column) of `end`, at most,
    for `count` cells from `first` on. The outermost are repeated past the border."""
    outermost = (first == 0) | (first + count >= end)
    return 1 + tl.where(outermost, 1, 0) + tl.where(end == 1, 1, 0)


@triton.jit
def copy_of(cell, k, end):
    """Return the k-th place at which the demosaic reads cells of a row (or column), and whether
    there is one: their own, and that beside the first or the last."""
    beside = tl.where((cell == 0) & (k == 1), -1, end)
    outermost = (cell == 0) | (cell == end - 1)
    exists = (k == 0) | ((k == 1) & outermost) | ((k == 2) & (end == 1))
    return tl.where(k == 0, cell, beside), exists


@triton.jit
def demosaic_back_kernel(
    raw_grad,
    light_grad,
    raw,
    size,
    DEMOSAIC: tl.constexpr,
    SATURATES: tl.constexpr,
    ROWS: tl.constexpr,
    COLS: tl.constexpr,
):
    """Fill raw_grad (B, 4, *size) from light_grad (B, 3, ...), of every sensor pixel."""
    height, width = size
    image, row, col, inside = tile(size, ROWS, COLS)
    light_grad += image * 12 * height * width
    row_copies = most_copies(tl.program_id(1) * ROWS, ROWS, height)
    col_copies = most_copies(tl.program_id(0) * COLS, COLS, width)
    for plane in range(4):
        total = tl.full(inside.shape, 0.0, tl.float32)
        for i in range(row_copies):
            y, row_exists = copy_of(row, i, height)
            y = 2 * y + plane // 2
            for j in range(col_copies):
                x, col_exists = copy_of(col, j, width)
                x = 2 * x + plane % 2
                there = inside & row_exists & col_exists
                total += demosaic_back(light_grad, y, x, 2 * height, 2 * width, there, DEMOSAIC)
        at = ((image * 4 + plane) * height + row) * width + col
        if SATURATES:
            total = tl.where(tl.load(raw + at, mask=inside, other=0.0) <= 1.0, total, 0.0)
        tl.store(raw_grad + at, total, mask=inside)


def codes_of_back(grad: Tensor, raw: Tensor, codes: CodesArrays) -> Tensor:
    """Return the gradient in readings, from that in what `develop.codes_of` returns."""
    height, width = size_of(raw)
    planes, step = raw.shape[1], codes.constants["STEP"]
    out = raw.new_empty(len(raw), planes if step == 1 else 3, height * step, width * step)
    sizes, arrays = (size_of(grad), size_of(raw)), (codes.looks, codes.rows, codes.cols)
    launch(light_back_kernel, out, grad, raw, *arrays, *sizes, PLANES=planes, **codes.constants)
    if step == 1:
        return out
    constants = {name: codes.constants[name] for name in ("DEMOSAIC", "SATURATES")}
    raw_grad = torch.empty_like(raw)
    launch(demosaic_back_kernel, raw_grad, out, raw, size_of(raw), **constants)
    return raw_grad


def develop_back(grad: Tensor, raw: Tensor, development: Development) -> Tensor:
    """Return the gradient in readings (B, planes, h, w), from that in photos (B, 3, H, W)."""
    arrays = develop_arrays(development, raw.device)
    raw, grad = raw.contiguous(), grad.contiguous()
    if arrays.registration is not None:
        grad = register_back(grad, arrays.registration)
    if arrays.detail is not None:
        grad = filter_detail_back(grad, codes_of(raw, arrays.codes), arrays.detail)
    return codes_of_back(grad, raw, arrays.codes)
