"""Readings to photos.

One kernel computes a photo from its reading. Where detail is filtered, it computes the codes of
every sensor pixel, of which two more make a photo (see `detail`); where the photo is brought back
to the image's frame, one more does so (see `registration`).
"""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu.demosaic import colours
from moireaug.engine.gpu.detail import filter_detail
from moireaug.engine.gpu.develop_arrays import CodesArrays, develop_arrays
from moireaug.engine.gpu.registration import register
from moireaug.engine.gpu.resize import first_pixel, tap_weight
from moireaug.engine.gpu.tile import launch, size_of, store_colours, tile
from moireaug.engine.gpu.tone import clip, codes, look_of
from moireaug.engine.lower.development_records import Development


@triton.jit
def develop_kernel(
    photo,
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
    """Fill photo (B, 3, *size) from raw (B, PLANES, *raw_size): means of sensor pixels' codes. The
    other arguments are in `develop_arrays.CodesArrays`."""
    image, row, col, inside = tile(size, ROWS, COLS)
    raw += image * PLANES * raw_size[0] * raw_size[1]
    look = look_of(looks, image)
    first_row = first_pixel(rows, row, size[0])
    first_col = first_pixel(cols, col, size[1])
    red = tl.full(inside.shape, 0.0, tl.float32)
    green = tl.full(inside.shape, 0.0, tl.float32)
    blue = tl.full(inside.shape, 0.0, tl.float32)
    for i in range(rows.tap_count):
        y = tl.minimum(first_row + i, raw_size[0] * STEP - 1)
        of_row = tap_weight(rows, row, i, size[0])
        for j in range(cols.tap_count):
            x = tl.minimum(first_col + j, raw_size[1] * STEP - 1)
            weight = of_row * tap_weight(cols, col, j, size[1])
            r, g, b = colours(raw, y, x, raw_size, inside, PLANES, DEMOSAIC, SATURATES, LEVELS)
            r, g, b = codes(r, g, b, look, CODED, TONED)
            red += weight * r
            green += weight * g
            blue += weight * b
    # weights of codes in [0, 1] sum to 1, but for rounding
    store_colours(photo, image, row, col, size, inside, clip(red), clip(green), clip(blue))


def codes_of(raw: Tensor, codes: CodesArrays) -> Tensor:
    """Return the codes (B, 3, h, w) of readings, resized, in the camera's frame."""
    photo = raw.new_empty(len(raw), 3, len(codes.rows.start), len(codes.cols.start))
    sizes, arrays = (size_of(photo), size_of(raw)), (codes.looks, codes.rows, codes.cols)
    launch(develop_kernel, photo, raw, *arrays, *sizes, PLANES=raw.shape[1], **codes.constants)
    return photo


def develop(raw: Tensor, development: Development) -> Tensor:
    """Return the photos (B, 3, H, W) float32 of readings (B, planes, h, w) float32."""
    arrays = develop_arrays(development, raw.device)
    photo = codes_of(raw.contiguous(), arrays.codes)
    if arrays.detail is not None:
        photo = filter_detail(photo, arrays.detail)
    if arrays.registration is not None:
        photo = register(photo, arrays.registration)
    return photo
