"""The panel: its subpixels and their light."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from moireaug.engine.lower.exposure_records import Cell
from moireaug.panel.fourier import emitting_share, mean_light
from moireaug.scene.layout import as_layout
from moireaug.shot import ShotRecord


class Shapes(NamedTuple):
    """What kinds of subpixel are like, of a batch; see `exposure_records.Exposure`."""

    coefficients: np.ndarray
    widths: np.ndarray
    added_variance: np.ndarray


class PanelView(NamedTuple):
    """How the pixels of a batch's readings see the panel; cameras, lenses: see
    `exposure_records.Exposure`."""

    cameras: np.ndarray
    lenses: np.ndarray
    cell: Cell
    shapes: Shapes


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
    channel = np.array([s[0] for s in subpixels], np.int64)
    centre = np.array([s[1] for s in subpixels], np.float64).reshape(-1, 2)
    kind = np.array([s[2] for s in subpixels], np.int64)
    pixel = np.floor(centre).astype(np.int64)
    period = np.array(periods, np.int64)
    y_group = _numbered(period[kind, 1], centre[:, 1])
    kind_y_group = _numbered(kind, y_group)
    whole = np.array([math.lcm(*lengths) for lengths in zip(*periods, strict=True)], np.int64)
    highest = np.array([_highest(o) for o in orders], np.int64)
    return Cell(whole, period, highest, channel, kind, y_group, kind_y_group, centre, pixel, radius)


def _numbered(*columns: np.ndarray) -> np.ndarray:
    """Return a number for each row of some columns, the same for equal ones."""
    rows = np.stack(columns, 1)
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def _highest(orders: np.ndarray) -> np.ndarray:
    """Return the highest k and the highest l of harmonics."""
    return np.abs(orders).max(1, initial=0)


def lower_shapes(
    edges: np.ndarray,
    periods: Sequence[tuple[int, int]],
    orders: Sequence[np.ndarray],
) -> Shapes:
    """Return the Shapes of kinds of subpixel.

    Args:
        edges: (B, kinds, 2, 2), two edge vectors of each kind, x then y, in panel pixels.
        periods: of each kind. orders: of each kind, its harmonics' k and l, (2, n) int64: k >= 0,
            conjugates and (0, 0) left out.
    """
    edges = edges / np.array(periods, np.float64)[:, None]
    n_k, n_l = np.max([_highest(o) for o in orders], axis=0)
    area = np.abs(edges[..., 0, 0] * edges[..., 1, 1] - edges[..., 0, 1] * edges[..., 1, 0])
    out = np.zeros((*area.shape, n_k + 1, 2 * n_l + 1))
    for kind, (k, l) in enumerate(orders):
        out[:, kind, 0, n_l] = area[:, kind]
        waves = np.sinc(edges[:, kind] @ orders[kind])  # (B, edge, harmonic)
        out[:, kind, k, l + n_l] = 2 * area[:, kind, None] * waves[:, 0] * waves[:, 1]
    long, short = np.abs(edges).max(-2), np.abs(edges).min(-2)
    return Shapes(out, long, short * short / 12)


@functools.lru_cache(maxsize=8)
def cell_of_whole_pixels(taps: int) -> Cell:
    """Return the Cell of a panel whose pixels emit all over, in each colour, of which `taps` are
    looked at along each axis."""
    subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
    none = np.empty((2, 0), np.int64)
    return lower_cell(subpixels, [(1, 1)] * 3, [none] * 3, taps // 2)


def mean_light_of(shot: ShotRecord) -> np.ndarray:
    """Return the share of the panel's area that emits each colour, (B, 3) float64."""
    layout = as_layout(shot.scene.panel.layout)
    width, height = (share.detach().numpy() for share in emitting_share(shot.panel))
    return np.stack([mean_light(layout, channel, width, height) for channel in range(3)], 1)
