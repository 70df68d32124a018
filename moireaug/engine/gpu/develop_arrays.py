"""A batch's development on the device of its readings: `development_records` as tensors, and what
kernels are compiled with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch

from moireaug.effects.detail import LEAST_SIGMA
from moireaug.engine.gpu.arrays import upload
from moireaug.engine.gpu.demosaic import Tap, taps_of
from moireaug.engine.lower.development_records import (
    Codes,
    Detail,
    Development,
    Registration,
    Resize,
)


class Coding(NamedTuple):
    """What kernels that make codes of readings are compiled with.

    Args:
        planes: of the readings, 4 before a demosaic, of these taps; else 3.
        saturates, levels, coded, toned: see `development_records.Codes`.
    """

    planes: int
    taps: tuple[Tap, ...]
    saturates: bool
    levels: float
    coded: bool
    toned: bool


class ResizeArrays(NamedTuple):
    """A linear resize along one axis, see `development_records.Resize`.

    Args:
        start: (m,) int32. taps: (m, T) float32. first, last: (n,) int32.
        size: n. photo_size: m. tap_count: T. target_count: the most photo pixels that a sensor
            pixel contributes to.
    """

    start: Any
    taps: Any
    first: Any
    last: Any
    size: int
    photo_size: int
    tap_count: int
    target_count: int


class CodesArrays(NamedTuple):
    """What makes codes of readings, see `development_records.Codes`.

    Args:
        looks: (B, 12) float32, of each image the colour matrix, row by row, shoulder, contrast and
            brightness.
    """

    looks: Any
    rows: ResizeArrays
    cols: ResizeArrays


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
    rows: ResizeArrays
    cols: ResizeArrays


class RegistrationArrays(NamedTuple):
    """What brings photos back to the image's frame.

    Args:
        forward: (B, 9) float64, homography from image to ideal photo coordinates, both about their
            centres. inverses: (B, 9) float64, its inverse.
        lenses: (B, 2) float64, k1 and k2. bends: whether any is not 0.
    """

    forward: Any
    inverses: Any
    lenses: Any
    bends: bool


class DevelopArrays(NamedTuple):
    """A batch's development; detail and registration are None where there is none."""

    codes: CodesArrays
    detail: DetailArrays | None
    registration: RegistrationArrays | None


def develop_arrays(d: Development, device: torch.device) -> tuple[DevelopArrays, Coding]:
    """Return a Development on a device, and the Coding of its codes."""
    codes = CodesArrays(_looks(d.codes), _resize_arrays(d.codes.rows), _resize_arrays(d.codes.cols))
    detail = _detail_arrays(d.detail) if d.finishes else None
    registration = _registration_arrays(d.registration) if d.registers else None
    return upload(DevelopArrays(codes, detail, registration), device), _coding(d.codes)


def _coding(c: Codes) -> Coding:
    planes, taps = (4, taps_of(c.demosaic)) if c.mosaic else (3, ())
    return Coding(planes, taps, c.saturates, float(c.levels), c.coded, c.toned)


def _looks(c: Codes) -> np.ndarray:
    tone = np.stack([c.shoulder, c.contrast, c.brighten], 1)
    return np.concatenate([c.matrix.reshape(-1, 9), tone], 1)


def _resize_arrays(resize: Resize) -> ResizeArrays:
    start, taps, first, last = resize[:4]
    target_count = max(int((last - first).max()) + 1, 0)
    photo_size, tap_count = taps.shape
    return ResizeArrays(start, taps, first, last, len(first), photo_size, tap_count, target_count)


def _detail_arrays(detail: Detail) -> DetailArrays:
    half = max(detail.chroma_size, detail.sharp_size) // 2
    at = np.arange(-half, half + 1)
    gaussians = []
    for sigma, size in ((detail.chroma, detail.chroma_size), (detail.sharp, detail.sharp_size)):
        sigma = np.maximum(sigma, LEAST_SIGMA)[:, None]
        weight = np.where(abs(at) <= size // 2, np.exp(-(at**2) / (2 * sigma**2)), 0.0)
        gaussians.append(weight / weight.sum(1, keepdims=True))
    rows, cols = _resize_arrays(detail.rows), _resize_arrays(detail.cols)
    return DetailArrays(np.stack(gaussians, 1), len(at), detail.amount, rows, cols)


def _registration_arrays(registration: Registration) -> RegistrationArrays:
    forward, lens = registration
    inverses = np.linalg.inv(forward).reshape(-1, 9)
    return RegistrationArrays(forward.reshape(-1, 9), inverses, lens, bool(lens.any()))
