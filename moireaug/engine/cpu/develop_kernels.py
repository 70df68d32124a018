"""The kernels of developing, and of its gradient, that Python calls; see `expose_kernels`."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu.compiling import fill, jit_inlined, kernel
from moireaug.engine.cpu.develop import develop_image
from moireaug.engine.cpu.develop_back import develop_image_back
from moireaug.engine.cpu.develop_detail import develop_detail_image, develop_detail_image_back
from moireaug.engine.cpu.register import (
    flat_length,
    image_to_photo,
    register,
    register_back,
    rows_read,
)

ZERO = np.float32(0)


@jit_inlined
def _image_to_photo(registration, i):
    """Return the ImageToPhoto of image i."""
    k1, k2 = registration.distortion[i]
    return image_to_photo(registration.forward[i], k1, k2)


def in_camera_length(d) -> int:
    """Return how many values `develop_kernel` needs for a photo in the camera's frame."""
    return flat_length(*d.size) if d.registers else 0


@jit_inlined
def _fill_photo(out, raw, d, i, top, bottom):
    """Fill rows `top` to `bottom` of photo i from its raw."""
    h, w = d.size
    photo, in_camera = out.photos[i], out.photos[i]
    highest, lowest = top, bottom
    if d.registers:
        to_photo = _image_to_photo(d.registration, i)
        in_camera = out.in_camera[: 3 * h * w].reshape(3, h, w)
        highest, lowest = rows_read(to_photo, h, w, top, bottom)
    if d.filters_detail:
        unclipped = out.unclipped[i : i + 1]
        develop_detail_image(in_camera, unclipped, raw, d.codes, d.detail, i, highest, lowest)
    else:
        develop_image(in_camera, raw, d.codes, i, highest, lowest)
    if d.registers:
        register(photo, out.in_camera, to_photo, top, bottom)


@kernel
def develop_kernel(out, raw, d, first, last, top, bottom):
    """Fill rows `top` to `bottom` of the photos from `first` to `last` from raw (B, planes, h, w)
    float32; out: see `records.Photos`, d: from `develop_arrays`."""
    for i in range(first, last):
        _fill_photo(out, raw[i], d, i, top, bottom)


@jit_inlined
def _fill_raw_grad(raw_grad, grad, in_camera, unclipped, raw, d, i):
    """Fill raw_grad with the gradient in image i's raw, from that in its photo."""
    h, w = d.size
    if d.registers:
        fill(in_camera, ZERO)
        register_back(in_camera, grad, _image_to_photo(d.registration, i))
        grad = in_camera[: 3 * h * w].reshape(3, h, w)
    if d.filters_detail:
        h, w = d.detail.size
        codes_grad = np.empty((3, h, w), np.float32)
        develop_detail_image_back(codes_grad, grad, unclipped[i], d.detail, i)
        grad = codes_grad
    develop_image_back(raw_grad, grad, raw, d.codes, i)


@kernel
def develop_back_kernel(raw_grad, photo_grad, in_camera, unclipped, raw, d, first, last):
    """Fill the gradients from `first` to `last` in raw, of raw's shape, from those in the photos.

    Args:
        in_camera: (`in_camera_length`(d),) float32, workspace. unclipped: what `develop_kernel`
            filled. d: as in `develop_kernel`.
    """
    for i in range(first, last):
        _fill_raw_grad(raw_grad[i], photo_grad[i], in_camera, unclipped, raw[i], d, i)
