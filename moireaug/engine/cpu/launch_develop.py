"""Developing of batches, and its gradient: tensors in and out."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.cpu import develop_kernels as kernels
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.first_use import prepare
from moireaug.engine.cpu.layout import lay_out
from moireaug.engine.cpu.records import Photos
from moireaug.engine.cpu.threads import each, each_share, surplus
from moireaug.engine.lower.development_records import Development


def launch_develop(raw: Tensor, saves: bool, development: Development) -> tuple[Tensor, Tensor]:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32,
    and a tensor that `launch_develop_back` takes.

    saves: `launch_develop_back` will be called; else that tensor may be empty.
    """
    prepare()
    development = lay_out(development)
    n, h = len(raw), development.size[0]
    count = n if development.finishes and saves else 0
    unclipped = torch.empty(count, 3, *development.detail.size, dtype=torch.uint8, device="cpu")
    photo = empty(n, 3, *development.size)
    arrays = photo.numpy(), unclipped.numpy(), array_of(raw)
    work = functools.partial(_fill_photos, *arrays, development)
    whole = n - surplus(n, h)
    each(functools.partial(work, top=0, bottom=h), whole)
    for i in range(whole, n):
        each_share(functools.partial(work, i, i + 1), h)
    return photo, unclipped


def launch_develop_back(
    grad: Tensor, raw: Tensor, unclipped: Tensor, development: Development
) -> Tensor:
    """Return the gradient in the readings, from that in the photos and the tensor that
    `launch_develop` saved."""
    out, development = empty(*raw.shape), lay_out(development)
    arrays = out.numpy(), array_of(grad), unclipped.numpy(), array_of(raw)
    each(functools.partial(_fill_raw_grads, *arrays, development), len(raw))
    return out


def _fill_photos(
    photos: np.ndarray,
    unclipped: np.ndarray,
    readings: np.ndarray,
    d: Development,
    first: int,
    last: int,
    top: int,
    bottom: int,
) -> None:
    """Fill rows `top` to `bottom` of the photos from `first` to `last`; see
    `develop_kernel`."""
    out = Photos(photos, np.zeros(kernels.photo_size(d), np.float32), unclipped)
    kernels.develop_kernel(out, readings, d, first, last, top, bottom)


def _fill_raw_grads(
    raw_grads: np.ndarray,
    photo_grads: np.ndarray,
    unclipped: np.ndarray,
    readings: np.ndarray,
    d: Development,
    first: int,
    last: int,
) -> None:
    """Fill the gradients from `first` to `last` in the readings."""
    in_camera = np.empty(kernels.photo_size(d), np.float32)
    given = photo_grads, in_camera, unclipped, readings, d, first, last
    kernels.develop_back_kernel(raw_grads, *given)
