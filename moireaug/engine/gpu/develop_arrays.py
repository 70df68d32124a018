"""A batch's development on the device of its readings: `development_records` as tensors, and what
kernels are compiled with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch

from moireaug.camera.effects.detail import MIN_SIGMA
from moireaug.engine.gpu.arrays import upload
from moireaug.engine.lower.development_records import Codes, Detail, Development


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


class DetailArrays(NamedTuple):
    """What filters codes, see `development_records.Detail`.

    Args:
        gaussians: (B, 2, taps) float32, the Gaussians of colour and of the unsharp mask, each of
            sum 1. taps: of either.
        amount: (B,) float32.
    """

    gaussians: Any
    taps: int
    amount: Any


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
    detail = _detail_arrays(d.detail) if d.filters_detail else None
    variant = CodesVariant(d.codes.planes, d.codes.saturates, d.codes.coded, d.codes.toned)
    return upload(DevelopArrays(_tones(d.codes), detail), device), variant


def _tones(c: Codes) -> np.ndarray:
    tone = np.stack([c.shoulder, c.contrast, c.brighten], 1)
    return np.concatenate([c.matrix.reshape(-1, 9), tone], 1)


def _detail_arrays(detail: Detail) -> DetailArrays:
    half = max(detail.chroma_size, detail.sharp_size) // 2
    at = np.arange(-half, half + 1)
    gaussians = []
    for sigma, size in ((detail.chroma, detail.chroma_size), (detail.sharp, detail.sharp_size)):
        sigma = np.maximum(sigma, MIN_SIGMA)[:, None]
        weight = np.where(abs(at) <= size // 2, np.exp(-(at**2) / (2 * sigma**2)), 0.0)
        gaussians.append(weight / weight.sum(1, keepdims=True))
    return DetailArrays(np.stack(gaussians, 1), len(at), detail.amount)
