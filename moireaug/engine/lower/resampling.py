"""The linear steps of development, demosaicing and resizing, as tables of weights."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from moireaug.camera.effects.resize import area_weights
from moireaug.engine.lower.development_records import Resize


@functools.lru_cache(maxsize=64)
def lower_resize(read: int, size: int, n: int, how: str) -> Resize:
    """Return the Resize of one axis.

    Args:
        read: sensor pixels that are read. size: photo pixels.
        n: how many of the read pixels, from the first on, are resized.
        how: see `Develop.resize`.
    """
    start, taps = _weights(n, size, how)
    return _resize(start, taps, read)


@functools.lru_cache(maxsize=64)
def lower_means(read: int, size: int, step: int, lead: int, reach: int) -> Resize:
    """Return the Resize of one axis to means.

    Args:
        step, lead, reach: each photo pixel is the mean of its own `step` pixels, which begin after
            `lead`, less `reach` at each side. The rest as in `lower_resize`.
    """
    count = step - 2 * reach
    start = lead + reach + step * np.arange(size)
    return _resize(start, np.full((size, count), 1 / count), read)


def _weights(n: int, m: int, how: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the first of n sensor pixels of each of m photo pixels, and the weights (m, T) from
    there on."""
    i, scale = np.arange(m), n / m
    if how == "area":
        start, taps = (np.array(values) for values in area_weights(n, m))
    elif how == "antialias":
        centre, support = scale * (i + 0.5), max(scale, 1.0)
        start = np.maximum((centre - support + 0.5).astype(np.int64), 0)
        end = np.minimum((centre + support + 0.5).astype(np.int64), n)
        k = np.arange(np.max(end - start))
        away = np.abs(start[:, None] + k - centre[:, None] + 0.5) / support
        taps = np.where(k < (end - start)[:, None], np.maximum(1 - away, 0.0), 0.0)
    else:  # point
        at = np.clip(scale * (i + 0.5) - 0.5, 0.0, n - 1.0)
        start = np.minimum(at.astype(np.int64), max(n - 2, 0))
        taps = np.stack([1 - (at - start), at - start], 1)[:, :n]
    taps = taps[:, : np.flatnonzero(taps.any(0))[-1] + 1]  # a triangle's ends weigh nothing
    return start, taps / taps.sum(1, keepdims=True)


def _resize(start: np.ndarray, taps: np.ndarray, read: int) -> Resize:
    """Return the Resize of photo pixels with weights `taps` (m, T) from sensor pixels `start` (m,)
    on."""
    size, tap_count = taps.shape
    pixel, used = pixels_of(start, taps, read)
    first, last = _contributions(pixel, used, read)
    return Resize(
        start=start.astype(np.int64),
        taps=taps.astype(np.float32),
        first=first,
        last=last,
        size=read,
        halves=read == 2 * size and tap_count == 2 and bool((taps == 0.5).all()),
    )


def pixels_of(start: np.ndarray, taps: np.ndarray, read: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sensor pixel that each weight is for, (m, T), at most the last one read, and which
    weights are used: those of pixels that are read, if not 0. start, taps: as in `Resize`."""
    pixel = start[:, None] + np.arange(taps.shape[1])
    return np.minimum(pixel, read - 1), (pixel < read) & (taps != 0)


def _contributions(pixel: np.ndarray, used: np.ndarray, read: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last photo pixel that each sensor pixel contributes to."""
    first, last = np.full(read, len(pixel)), np.full(read, -1)
    photo = np.nonzero(used)[0]
    np.minimum.at(first, pixel[used], photo)
    np.maximum.at(last, pixel[used], photo)
    return first, last


@functools.lru_cache(maxsize=8)
def demosaic_weights(demosaic: Callable[[Tensor], Tensor]) -> np.ndarray:
    """Return a demosaic's weights, see `Codes.demosaic`, found by lighting each pixel of a cell and
    its neighbours once.

    Args:
        demosaic: from RGGB mosaics (B, h, w) to colours (B, 3, h, w); linear, and reading at most
            two pixels to each side.
    """
    side = 5
    lit = torch.eye(4 * 9, dtype=torch.float64, device="cpu").reshape(36, 4, 3, 3)
    planes = torch.nn.functional.pad(lit, (1, 1, 1, 1))
    colours = demosaic(torch.nn.functional.pixel_shuffle(planes, 2)[:, 0])
    # the two by two pixels of the cell in the middle
    middle = colours[..., side - 1 : side + 1, side - 1 : side + 1]
    return middle.reshape(4, 3, 3, 3, 4).permute(4, 3, 0, 1, 2).numpy().astype(np.float32, "C")
