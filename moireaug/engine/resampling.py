"""The linear steps of development as tables: demosaicing as a stencil, resizing as weights."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.record import Resize, Stencil


def _ceil(n: int, unit: int) -> int:
    return (n + unit - 1) // unit * unit


def _weights(n: int, m: int, how: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the first sensor pixel of each of m photo pixels, and the weights (m, T) from there
    on."""
    i, scale = np.arange(m), n / m
    if how == "area":
        start, end = i * n // m, -((i + 1) * n // -m)
        taps = np.where(np.arange((end - start).max()) < (end - start)[:, None], 1.0, 0.0)
    elif how == "antialias":
        centre, support = scale * (i + 0.5), max(scale, 1.0)
        start = np.maximum((centre - support + 0.5).astype(np.int64), 0)
        end = np.minimum((centre + support + 0.5).astype(np.int64), n)
        k = np.arange((end - start).max())
        away = np.abs(start[:, None] + k - centre[:, None] + 0.5) / support
        taps = np.where(k < (end - start)[:, None], np.maximum(1 - away, 0.0), 0.0)
    elif how == "point":
        at = np.clip(scale * (i + 0.5) - 0.5, 0.0, n - 1.0)
        start = np.minimum(at.astype(np.int64), max(n - 2, 0))
        taps = np.stack([1 - (at - start), at - start], 1)[:, :n]
    else:
        raise ValueError(f'resize must be "area", "antialias" or "point"; got {how!r}.')
    return start, taps / taps.sum(1, keepdims=True)


@functools.lru_cache(maxsize=64)
def lower_resize(
    read: int, size: int, n: int, how: str, step: int, lead: int, reach: int, parity: int, unit: int
) -> Resize:
    """Return one axis' Resize.

    Args:
        read: sensor pixels that are read. size: photo pixels.
        n: how many of the read pixels, from the first on, are resized by `how`.
        step, lead, reach: if step > 1 and `how` is "point", each photo pixel is instead the mean of
            its own `step` pixels, which begin after `lead`, less `reach` at each side.
        parity: 2 if even and odd columns are held apart, else 1. unit: the multiple to which rows
            are padded.
    """
    if step > 1 and how == "point":
        start = lead + np.arange(size) * step + reach
        taps = np.full((size, step - 2 * reach), 1 / (step - 2 * reach))
    else:
        start, taps = _weights(n, size, how)
    end = start + (taps > 0).sum(1) if how == "antialias" else start + taps.shape[1]
    end = np.minimum(end, read)
    photo = np.arange(size)
    first, last = np.full(read, size), np.full(read, -1)
    index, weight = (
        np.zeros((taps.shape[1], size), np.int32),
        np.zeros((taps.shape[1], size), np.float32),
    )
    transpose: list[list[tuple[int, float]]] = [[] for _ in range(read)]
    lanes = _ceil(-(-read // parity), unit)
    for t in range(taps.shape[1]):
        at = np.minimum(start + t, read - 1)
        used = (start + t < end) & (taps[:, t] != 0)
        np.minimum.at(first, at[used], photo[used])
        np.maximum.at(last, at[used], photo[used])
        index[t] = at % parity * 3 * lanes + at // parity
        weight[t] = np.where(used, taps[:, t], 0.0)
        for pixel, target, share in zip(
            at[used].tolist(), photo[used].tolist(), taps[used, t].tolist(), strict=True
        ):
            transpose[pixel].append((target, share))
    most = max(1, max(len(entry) for entry in transpose))
    back = (
        np.zeros((parity, most, read // parity), np.int32),
        np.zeros((parity, most, read // parity), np.float32),
    )
    for pixel, entries in enumerate(transpose):
        for t, (target, share) in enumerate(entries):
            back[0][pixel % parity, t, pixel // parity] = target
            back[1][pixel % parity, t, pixel // parity] = share
    each = taps.shape[1] == 1 and bool((start == photo).all())
    pairs = read == 2 * size and taps.shape[1] == 2 and bool((taps == 0.5).all())
    rows = (
        start.astype(np.int64),
        taps.astype(np.float32),
        first.astype(np.int64),
        last.astype(np.int64),
    )
    return Resize(*rows, index, weight, *back, each, pairs)


def lower_stencil(demosaic: Callable[[Tensor], Tensor] | None, cells: int, unit: int) -> Stencil:
    """Return a demosaic's Stencil, found by lighting each pixel of a cell and its neighbours once.

    Args:
        demosaic: from RGGB mosaics (B, h, w) to colours (B, 3, h, w); linear, and reading at most
            two pixels to each side. None for a sensor without colour filters.
        cells: cells in a row. unit: the multiple to which rows are padded.
    """
    weights: list[float] = []
    offsets: list[int] = []
    first, count = np.zeros((4, 3, 3), np.int64), np.zeros((4, 3, 3), np.int64)
    wide = _ceil(cells, unit) + unit
    for site, channel, dy, taps in _taps(demosaic) if demosaic else ():
        first[site, channel, dy], count[site, channel, dy] = len(weights), len(taps)
        for plane, dx, value in taps:
            weights.append(value)
            offsets.append(plane * wide + dx)
    return Stencil(
        np.array(weights or [0.0], np.float32), np.array(offsets or [0], np.int64), first, count
    )


@functools.lru_cache(maxsize=8)
def _taps(
    demosaic: Callable[[Tensor], Tensor],
) -> tuple[tuple[int, int, int, tuple[tuple[int, int, float], ...]], ...]:
    """Return (site, channel, row, ((plane, column, weight), ...)), rows and columns of cells
    counted from the one before."""
    side = 5
    lit = torch.eye(4 * 9, dtype=torch.float64).reshape(36, 4, 3, 3)
    planes = torch.nn.functional.pad(lit, (1, 1, 1, 1))
    colours = demosaic(torch.nn.functional.pixel_shuffle(planes, 2)[:, 0])
    # the two by two pixels of the cell in the middle
    middle = colours[..., side - 1 : side + 1, side - 1 : side + 1]
    found = []
    for site in range(4):
        for channel in range(3):
            seen = middle[:, channel, site // 2, site % 2].reshape(4, 3, 3)
            for dy in range(3):
                taps = [
                    (plane, dx, float(seen[plane, dy, dx]))
                    for plane in range(4)
                    for dx in range(3)
                    if seen[plane, dy, dx] != 0
                ]
                if taps:
                    found.append((site, channel, dy, tuple(taps)))
    return tuple(found)
