"""A batch's development on the device of its readings: `development_records` as tensors, and what
kernels are compiled with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch

from moireaug.camera.effects.detail import MIN_SIGMA
from moireaug.engine.gpu.arrays import upload
from moireaug.engine.gpu.demosaic import Tap, taps_of
from moireaug.engine.lower.development_records import (
    Codes,
    Detail,
    Development,
    Registration,
    Resize,
)


class CodesVariant(NamedTuple):
    """What kernels that make codes of readings are compiled with.

    Args:
        planes: of the readings. taps: of their demosaic; () if they need none.
        saturates, levels, coded, toned: see `development_records.Codes`.
    """

    planes: int
    taps: tuple[Tap, ...]
    saturates: bool
    levels: float
    coded: bool
    toned: bool


class CodesArrays(NamedTuple):
    """What makes codes of readings, see `development_records.Codes`.

    Args:
        tones: (B, 12) float32, of each image the colour matrix, row by row, shoulder, contrast and
            brightness.
    """

    tones: Any
    rows: Resize
    cols: Resize


class DetailArrays(NamedTuple):
    """What filters codes, and resizes them, see `development_records.Detail`.

    Args:
        gaussians: (B, 2, taps) float32, the Gaussians of colour and of the unsharp mask, each of
            sum 1. taps: of either.
        amount: (B,) float32.
    """

    gaussians: Any
    taps: int
    amount: Any
    rows: Resize
    cols: Resize


class RegistrationArrays(NamedTuple):
    """A `development_records.Registration`, the inverses of its homographies, (B, 3, 3) float64,
    and whether any lens distorts."""

    forward: Any
    inverses: Any
    distortion: Any
    distorts: bool


class DevelopArrays(NamedTuple):
    """A batch's development; detail and registration are None where there is none."""

    codes: CodesArrays
    detail: DetailArrays | None
    registration: RegistrationArrays | None


def develop_arrays(d: Development, device: torch.device) -> tuple[DevelopArrays, CodesVariant]:
    """Return a Development on a device, and the CodesVariant of its codes."""
    codes = CodesArrays(_tones(d.codes), d.codes.rows, d.codes.cols)
    detail = _detail_arrays(d.detail) if d.filters_detail else None
    registration = _registration_arrays(d.registration) if d.registers else None
    return upload(DevelopArrays(codes, detail, registration), device), _variant(d.codes)


def _variant(c: Codes) -> CodesVariant:
    taps = taps_of(c.demosaic) if c.mosaic else ()
    return CodesVariant(c.planes, taps, c.saturates, float(c.levels), c.coded, c.toned)


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
    return DetailArrays(np.stack(gaussians, 1), len(at), detail.amount, detail.rows, detail.cols)


def _registration_arrays(r: Registration) -> RegistrationArrays:
    distorts = bool(r.distortion.any())
    return RegistrationArrays(r.forward, np.linalg.inv(r.forward), r.distortion, distorts)
