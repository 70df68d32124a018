"""From a scene's drawn numbers, as float64 arrays, to the kernels' records."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from moireaug.engine.lower.exposure_records import Camera, Cell, Sites

HOMOGRAPHY_FIELDS = [f"h{row}{column}" for row in range(3) for column in range(3)]


def lower_cameras(
    inverse: np.ndarray,
    size: tuple[int, int],
    scales: tuple[float | np.ndarray, float | np.ndarray],
    fields: dict[str, np.ndarray],
) -> np.ndarray:
    """Return the fields of one Camera per image, (B, fields).

    Args:
        inverse: (B, 3, 3), homography from ideal photo coordinates about the centre to image
            coordinates.
        size: height and width of photo and image. scales: sensor pixels per photo pixel, along rows
            and columns, one number or (B,) each.
        fields: (B,) each: k1, k2, alpha, fill, blur, olpf, gain, read, shot, vignetting, motion_x,
            motion_y, glare, glare_x, glare_y and rectified; neutral values for effects that are not
            planned.
    """
    h, w = size
    homography = dict(zip(HOMOGRAPHY_FIELDS, inverse.reshape(-1, 9).T, strict=True))
    derived = {
        "bend": 4 / (h * h + w * w),
        "scale_u": scales[1],
        "scale_v": scales[0],
        "dark_noise": fields["read"],
        "photon_noise": fields["shot"],
        "falloff": (1 - fields["vignetting"]) ** -0.5 - 1,
        "glare_u": fields["glare"] * fields["glare_x"] * 2 / w,
        "glare_v": fields["glare"] * fields["glare_y"] * 2 / h,
    }
    columns = fields | homography | derived
    cameras = np.empty((len(inverse), len(Camera._fields)))
    for i, name in enumerate(Camera._fields):
        cameras[:, i] = columns[name]
    return cameras


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
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients, widths and added variances of `exposure_records.Exposure`.

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
    return out, long, short * short / 12


def lower_sites(
    rows: np.ndarray,
    cols: np.ndarray,
    size: tuple[int, int],
    cfa: Sequence[tuple[int, int, tuple[int, ...]]],
) -> Sites:
    """Return the Sites of a sensor that is read at photo coordinates rows and cols.

    Args:
        cfa: (row, column, channels) of each site of a cell, in the order of the planes.
    """
    planes = [(r, c, channel) for r, c, channels in cfa for channel in channels]
    step = math.isqrt(len(cfa))
    row, col, channel = (np.array(values, np.int64) for values in zip(*planes, strict=True))
    return Sites(rows - size[0] / 2, cols - size[1] / 2, step, row, col, channel)
