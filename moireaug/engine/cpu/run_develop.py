"""Developing of batches, and its gradient: tensors in and out."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.cpu import batch_develop as batch
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.first_use import prepare
from moireaug.engine.cpu.layout import lay_out
from moireaug.engine.cpu.records import Photos
from moireaug.engine.cpu.threads import each, each_share, surplus
from moireaug.engine.lower.development_records import Development


def develop(raw: Tensor, saves: bool, development: Development) -> tuple[Tensor, Tensor]:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32,
    and a tensor that `develop_back` takes.

    saves: `develop_back` will be called; else that tensor may be empty.
    """
    prepare()
    development = lay_out(development)
    n, h = len(raw), development.size[0]
    count = n if development.finishes and saves else 0
    unclipped = torch.empty(count, 3, *development.detail.size, dtype=torch.uint8, device="cpu")
    photo = empty(n, 3, *development.size)
    arrays = photo.numpy(), unclipped.numpy(), array_of(raw)
    work = functools.partial(_develop, *arrays, development)
    whole = n - surplus(n, h)
    each(functools.partial(work, top=0, bottom=h), whole)
    for i in range(whole, n):
        each_share(functools.partial(work, i, i + 1), h)
    return photo, unclipped


def develop_back(grad: Tensor, raw: Tensor, unclipped: Tensor, development: Development) -> Tensor:
    """Return the gradient in the readings, from that in the photos and what `develop` saved."""
    out, development = empty(*raw.shape), lay_out(development)
    arrays = out.numpy(), array_of(grad), unclipped.numpy(), array_of(raw)
    each(functools.partial(_develop_back, *arrays, development), len(raw))
    return out


def _develop(
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
    `batch_develop.develop`."""
    out = Photos(photos, np.zeros(batch.photo_size(d), np.float32), unclipped)
    batch.develop(out, readings, d, first, last, top, bottom)


def _develop_back(
    raw_grads: np.ndarray,
    photo_grads: np.ndarray,
    unclipped: np.ndarray,
    readings: np.ndarray,
    d: Development,
    first: int,
    last: int,
) -> None:
    """Fill the gradients from `first` to `last` in the readings; see
    `batch_develop.develop_back`."""
    in_camera = np.empty(batch.photo_size(d), np.float32)
    batch.develop_back(raw_grads, photo_grads, in_camera, unclipped, readings, d, first, last)
