"""The gradient of readings in pictures: tensors in and out."""

from __future__ import annotations

import functools

import numpy as np
from torch import Tensor

from moireaug.engine.cpu import batch_expose_back as batch
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.first_use import prepare_back
from moireaug.engine.cpu.run_expose import light_of, shown_of
from moireaug.engine.cpu.threads import each
from moireaug.engine.lower.exposure_records import Beats, Exposure


def expose_back(
    grad: Tensor, picture: Tensor, slopes: Tensor, exposure: Exposure, beats: Beats | None
) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings and what
    `run_expose.expose` saved."""
    prepare_back()
    out = empty(*picture.shape)
    arrays = out.numpy(), array_of(grad), slopes.numpy(), array_of(picture)
    work = _points_back if exposure.point else functools.partial(_images_back, beats)
    each(functools.partial(work, *arrays, exposure), len(picture))
    return out


def _points_back(
    grads: np.ndarray,
    raw_grads: np.ndarray,
    slopes: np.ndarray,
    pictures: np.ndarray,
    exposure: Exposure,
    first: int,
    last: int,
) -> None:
    """Fill the gradients from `first` to `last` of a point exposure."""
    given = raw_grads, slopes, pictures, exposure, first, last
    batch.expose_points_back(grads, light_of(exposure), *given)


def _images_back(
    beats: Beats | None,
    grads: np.ndarray,
    raw_grads: np.ndarray,
    slopes: np.ndarray,
    pictures: np.ndarray,
    exposure: Exposure,
    first: int,
    last: int,
) -> None:
    """Fill the gradients from `first` to `last`: of what the panel shows, then of pictures."""
    light_grad, shown_grads = light_of(exposure), shown_of(exposure)
    for start in range(first, last, len(shown_grads)):
        end = min(start + len(shown_grads), last)
        given = shown_grads, raw_grads, slopes, exposure
        if beats is None:
            batch.expose_full_back(*given, start, end)
        else:
            batch.expose_binned_back(*given, beats, start, end)
        batch.show_back(grads, shown_grads, light_grad, pictures, exposure, start, end)
