"""A batch's development on the device of its readings: `development_records` as tensors, and what
kernels are compiled with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from moireaug.effects.detail import LEAST_SIGMA
from moireaug.engine.gpu.arrays import upload
from moireaug.engine.gpu.demosaic import taps_of
from moireaug.engine.lower.development_records import (
    Codes,
    Detail,
    Development,
    Registration,
    Resize,
)


class ResizeArrays(NamedTuple):
    """A linear resize along one axis, see `development_records.Resize`.

    Args:
        start: (m,) int32. taps: (m, T) float32. first, last: (n,) int32.
        tap_count: T. photo_pixels: the most that a sensor pixel contributes to.
    """

    start: Tensor
    taps: Tensor
    first: Tensor
    last: Tensor
    tap_count: int
    photo_pixels: int


class CodesArrays(NamedTuple):
    """What makes codes of readings, see `development_records.Codes`.

    Args:
        looks: (B, 12) float32, of each image the colour matrix, row by row, shoulder, contrast and
            brightness.
        constants: what kernels are compiled with. DEMOSAIC: the taps of a demosaic; none where each
            pixel of the planes is one of the photo. STEP: sensor pixels along each side of a filter
            cell. SATURATES, LEVELS, CODED and TONED: see `development_records.Codes`.
    """

    looks: Tensor
    rows: ResizeArrays
    cols: ResizeArrays
    constants: dict[str, Any]


class DetailArrays(NamedTuple):
    """What filters codes, and resizes them, see `development_records.Detail`.

    Args:
        gaussians: (B, 2, taps) float32, the Gaussians of colour and of the unsharp mask, each of
            sum 1. taps: of either.
        amount: (B,) float32.
    """

    gaussians: Tensor
    taps: int
    amount: Tensor
    rows: ResizeArrays
    cols: ResizeArrays


class RegistrationArrays(NamedTuple):
    """What brings photos back to the image's frame.

    Args:
        views: (B, 9) float64, homography from image to ideal photo coordinates, both about their
            centres. inverses: (B, 9) float64, its inverse.
        lenses: (B, 2) float64, k1 and k2. bends: whether any is not 0.
    """

    views: Tensor
    inverses: Tensor
    lenses: Tensor
    bends: bool


class DevelopArrays(NamedTuple):
    """A batch's development; detail and registration are None where there is none."""

    codes: CodesArrays
    detail: DetailArrays | None
    registration: RegistrationArrays | None


def develop_arrays(d: Development, device: torch.device) -> DevelopArrays:
    """Return a Development on a device."""
    arrays = {"looks": _looks(d.codes)}
    arrays |= _resize_arrays("codes.rows", d.codes.rows) | _resize_arrays(
        "codes.cols", d.codes.cols
    )
    if d.finishes:
        arrays |= {"gaussians": _gaussians(d.detail), "amount": d.detail.amount}
        arrays |= _resize_arrays("rows", d.detail.rows) | _resize_arrays("cols", d.detail.cols)
    if d.registers:
        arrays |= _registration_arrays(d.registration)
    there = upload(arrays, device)
    codes = CodesArrays(
        there["looks"],
        _resize("codes.rows", d.codes.rows, there),
        _resize("codes.cols", d.codes.cols, there),
        _constants(d.codes),
    )
    detail, registration = None, None
    if d.finishes:
        resizes = _resize("rows", d.detail.rows, there), _resize("cols", d.detail.cols, there)
        taps = there["gaussians"].shape[2]
        detail = DetailArrays(there["gaussians"], taps, there["amount"], *resizes)
    if d.registers:
        bends = bool(d.registration.lens.any())
        registration = RegistrationArrays(there["views"], there["inverses"], there["lenses"], bends)
    return DevelopArrays(codes, detail, registration)


def _constants(c: Codes) -> dict[str, Any]:
    return {
        "DEMOSAIC": taps_of(c.demosaic) if c.mosaic else (),
        "STEP": 2 if c.mosaic else 1,
        "SATURATES": c.saturates,
        "LEVELS": float(c.levels),
        "CODED": c.coded,
        "TONED": c.toned,
    }


def _looks(c: Codes) -> np.ndarray:
    tone = np.stack([c.shoulder, c.contrast, c.brighten], 1)
    return np.concatenate([c.matrix.reshape(-1, 9), tone], 1, dtype=np.float32)


def _resize_arrays(name: str, resize: Resize) -> dict[str, np.ndarray]:
    """Return a resize's arrays by names that begin with its own."""
    return {
        f"{name}.start": resize.start.astype(np.int32),
        f"{name}.taps": resize.taps,
        f"{name}.first": resize.first.astype(np.int32),
        f"{name}.last": resize.last.astype(np.int32),
    }


def _resize(name: str, resize: Resize, there: dict[str, Tensor]) -> ResizeArrays:
    photo_pixels = max(int((resize.last - resize.first).max()) + 1, 0)
    return ResizeArrays(
        there[f"{name}.start"],
        there[f"{name}.taps"],
        there[f"{name}.first"],
        there[f"{name}.last"],
        resize.taps.shape[1],
        photo_pixels,
    )


def _gaussians(detail: Detail) -> np.ndarray:
    """Return the Gaussians of a batch, (B, 2, taps) float32."""
    half = max(detail.chroma_size, detail.sharp_size) // 2
    at = np.arange(-half, half + 1)
    out = []
    for sigma, size in ((detail.chroma, detail.chroma_size), (detail.sharp, detail.sharp_size)):
        sigma = np.maximum(sigma, LEAST_SIGMA)[:, None]
        weight = np.where(abs(at) <= size // 2, np.exp(-(at**2) / (2 * sigma**2)), 0.0)
        out.append(weight / weight.sum(1, keepdims=True))
    return np.stack(out, 1).astype(np.float32)


def _registration_arrays(registration: Registration) -> dict[str, np.ndarray]:
    views = registration.views
    inverses = np.linalg.inv(views)
    return {
        "views": views.reshape(-1, 9),
        "inverses": inverses.reshape(-1, 9),
        "lenses": registration.lens,
    }
