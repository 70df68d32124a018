"""Developing of batches, and its gradient: tensors in and out."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.cpu import develop_kernels as kernels
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.develop_arrays import develop_arrays
from moireaug.engine.cpu.records import Photos
from moireaug.engine.cpu.threads import run_in_parts, run_in_shares, surplus_images
from moireaug.engine.lower.development_records import Development


def launch_develop(raw: Tensor, saves: bool, development: Development) -> tuple[Tensor, Tensor]:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32,
    and a tensor that `launch_develop_back` takes.

    saves: `launch_develop_back` will be called; else that tensor may be empty.
    """
    arrays = develop_arrays(development)
    n, h = len(raw), arrays.size[0]
    count = n if arrays.filters_detail and saves else 0
    unclipped = torch.empty(count, 3, *arrays.detail.size, dtype=torch.uint8, device="cpu")
    photo, readings = empty(n, 3, *arrays.size), array_of(raw)
    filled = photo.numpy(), unclipped.numpy()

    def fill_photos(first: int, last: int, top: int = 0, bottom: int = h) -> None:
        in_camera = np.zeros(kernels.in_camera_length(arrays), np.float32)
        out = Photos(filled[0], in_camera, filled[1])
        kernels.develop_kernel(out, readings, arrays, first, last, top, bottom)

    whole = n - surplus_images(n, h)
    run_in_parts(fill_photos, whole)
    for i in range(whole, n):
        run_in_shares(functools.partial(fill_photos, i, i + 1), h)
    return photo, unclipped


def launch_develop_back(
    grad: Tensor, raw: Tensor, unclipped: Tensor, development: Development
) -> Tensor:
    """Return the gradient in the readings, from that in the photos and the tensor that
    `launch_develop` saved."""
    out, arrays = empty(*raw.shape), develop_arrays(development)
    raw_grads, photo_grads, readings = out.numpy(), array_of(grad), array_of(raw)

    def fill_grads(first: int, last: int) -> None:
        in_camera = np.empty(kernels.in_camera_length(arrays), np.float32)
        given = in_camera, unclipped.numpy(), readings, arrays, first, last
        kernels.develop_back_kernel(raw_grads, photo_grads, *given)

    run_in_parts(fill_grads, len(raw))
    return out
