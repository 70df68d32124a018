"""A batch's development as the CPU's kernels take it: the weights of demosaic and resize, and the
places of what they weigh in rows of values."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.vectors import LANES, padded_width
from moireaug.engine.lower.development_records import Development, Resize
from moireaug.engine.lower.resampling import pixels_of


class Demosaic(NamedTuple):
    """A demosaic: each site's colours as sums over the packed planes of the cell rows above, at and
    below it.

    Args:
        weight: (taps,) float32. offset: (taps,) int64, where in a prepared cell row the tap's pixel
            is.
        first, count: (4 sites, 3 channels, 3 rows) int64, index of each one's first
            tap, and how many it has.
    """

    weight: np.ndarray
    offset: np.ndarray
    first: np.ndarray
    count: np.ndarray  # type: ignore[assignment]  # hides tuple.count: not called


class Columns(NamedTuple):
    """A resize along rows, from n sensor pixels to m photo pixels.

    Args:
        index, weight: (T, m) int32 and float32, the taps' places in a row of colours, as
            `codes.Workspace` lays it out, and their weights.
        back_index, back_weight: (p, T', n / p), the transpose; p is 2 if even and odd columns lie
            apart, else 1.
        halves: see `development_records.Resize`.
    """

    index: np.ndarray  # type: ignore[assignment]  # hides tuple.index: not called
    weight: np.ndarray
    back_index: np.ndarray
    back_weight: np.ndarray
    halves: bool


def develop_arrays(d: Development) -> Development:
    """Return a Development as kernels take it."""
    columns = _columns_of(d.codes.cols, 2 if d.codes.mosaic else 1)
    demosaic = _demosaic(d.codes.demosaic.tobytes(), d.codes.cols.size // 2)
    codes = d.codes._replace(demosaic=demosaic, cols=columns)
    detail = d.detail._replace(cols=_columns_of(d.detail.cols, 1))
    return d._replace(codes=codes, detail=detail)


@functools.lru_cache(maxsize=64)
def _demosaic(data: bytes, cells: int) -> Demosaic:
    """Return the Demosaic of `Codes.demosaic`, by its bytes; cells: in a row."""
    weight = np.frombuffer(data, np.float32).reshape(4, 3, 4, 3, 3)
    wide = padded_width.py_func(cells) + LANES
    weights: list[float] = []
    offsets: list[int] = []
    first, count = np.zeros((4, 3, 3), np.int64), np.zeros((4, 3, 3), np.int64)
    for site, channel, dy in np.ndindex(4, 3, 3):
        taps = weight[site, channel, :, dy]
        first[site, channel, dy], count[site, channel, dy] = len(weights), np.count_nonzero(taps)
        for plane, dx in np.argwhere(taps):
            weights.append(taps[plane, dx])
            offsets.append(plane * wide + dx)
    return Demosaic(
        np.array(weights or [0.0], np.float32), np.array(offsets or [0], np.int64), first, count
    )


def _columns_of(resize: Resize, parity: int) -> Columns:
    """Return a resize's Columns; parity: 2 if even and odd columns are held apart, else 1."""
    table = resize.start.tobytes(), resize.taps.tobytes()
    index, weight, back_index, back_weight = _places(*table, resize.size, parity)
    return Columns(index, weight, back_index, back_weight, resize.halves)


@functools.lru_cache(maxsize=64)
def _places(start: bytes, taps: bytes, read: int, parity: int) -> tuple[np.ndarray, ...]:
    """Return the first four fields of `Columns`, of a resize of `read` sensor pixels, by the bytes
    of its arrays."""
    first = np.frombuffer(start, np.int64)
    weights = np.frombuffer(taps, np.float32).reshape(len(first), -1)
    pixel, used = pixels_of(first, weights, read)
    gathered = _gathered(pixel, used, weights, read, parity)
    return *gathered, *_transposed(pixel, used, weights, read, parity)


def _gathered(
    pixel: np.ndarray, used: np.ndarray, taps: np.ndarray, read: int, parity: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return where each tap's pixel is in a row of colours, and its weight, (T, m) each."""
    # a colour of the odd columns lies the three colours of the even ones further on
    lanes = padded_width.py_func(-(-read // parity))
    index = pixel % parity * 3 * lanes + pixel // parity
    weight = np.where(used, taps, 0.0)
    return index.T.astype(np.int32, "C"), weight.T.astype(np.float32, "C")


def _transposed(
    pixel: np.ndarray, used: np.ndarray, taps: np.ndarray, read: int, parity: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the photo pixels that each sensor pixel contributes to, and the weights, in the order
    of taps."""
    most = max(1, int(np.max(np.bincount(pixel[used]))))
    index = np.zeros((parity, most, read // parity), np.int32)
    weight = np.zeros((parity, most, read // parity), np.float32)
    count = [0] * read
    for tap, photo in zip(*np.nonzero(used.T), strict=True):
        at = pixel[photo, tap]
        place = at % parity, count[at], at // parity
        index[place], weight[place] = photo, taps[photo, tap]
        count[at] += 1
    return index, weight
