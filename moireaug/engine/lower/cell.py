"""The panel: its subpixels and their light."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from moireaug.engine.lower.exposure_records import Cell


def lower_cell(
    subpixels: Sequence[tuple[int, tuple[float, float], int]],
    periods: Sequence[tuple[int, int]],
    orders: Sequence[np.ndarray],
    radius: int,
) -> Cell:
    """Return the Cell of (channel, centre, kind) subpixels, centres in panel pixels from their
    cell's corner.

    Args:
        periods: of each kind. orders: of each kind, its harmonics' k and l, (2, n) int64.
        radius: see `Cell`.
    """
    channels, centres, kinds = zip(*subpixels, strict=True)
    kind, period = np.array(kinds, np.int64), np.array(periods, np.int64)
    centre = np.array(centres, np.float64)
    y_group = _numbered(period[kind, 1], centre[:, 1])
    return Cell(
        common_period=np.lcm.reduce(period),
        period=period,
        orders=np.array([highest_orders(o) for o in orders], np.int64),
        channel=np.array(channels, np.int64),
        subpixel_kind=kind,
        y_group=y_group,
        kind_y_group=_numbered(kind, y_group),
        centre=centre,
        pixel=np.floor(centre).astype(np.int64),
        radius=radius,
    )


def _numbered(*columns: np.ndarray) -> np.ndarray:
    """Return a number for each row of some columns, the same for equal ones."""
    rows = np.stack(columns, 1)
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def highest_orders(orders: np.ndarray) -> np.ndarray:
    """Return the highest k and the highest l of harmonics."""
    return np.abs(orders).max(1, initial=0)


@functools.lru_cache(maxsize=8)
def cell_of_whole_pixels(taps: int) -> Cell:
    """Return the Cell of a panel whose pixels emit all over, in each colour, of which `taps` are
    looked at along each axis."""
    subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
    none = np.empty((2, 0), np.int64)
    return lower_cell(subpixels, [(1, 1)] * 3, [none] * 3, taps // 2)
