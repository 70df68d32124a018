"""From a scene's drawn numbers, as tensors, to the kernels' records."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from moireaug.effects.random_numbers import keys
from moireaug.engine.record import Camera, Cell, Sites


def lower_cameras(
    inverse: Tensor, size: tuple[int, int], scales: tuple[float, float], **fields: Tensor
) -> list[Camera]:
    """Return one Camera an image.

    Args:
        inverse: (B, 3, 3) float64, homography from ideal photo coordinates to image coordinates.
        size: height and width of photo and image. scales: sensor pixels per photo pixel, along rows and columns.
        fields: (B,) each: k1, k2, alpha, fill, blur, olpf, gain, read, shot and vignetting; an effect that is not
            called for at its identity.
    """
    h, w = size
    centre = inverse.new_tensor([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    homography = (inverse @ centre).flatten(1)
    n = len(inverse)
    bend = inverse.new_full((n,), 4 / (h * h + w * w))
    by_v, by_u = (inverse.new_full((n,), scale) for scale in scales)
    falloff = (1 - fields["vignetting"]) ** -0.5 - 1
    names = ("alpha", "fill", "blur", "olpf", "gain", "read", "shot")
    alpha, *optics = [fields[name].double() for name in names]
    columns = [*homography.unbind(1), fields["k1"], fields["k2"], bend, alpha, by_u, by_v, *optics, falloff]
    rows = torch.stack([column.double() for column in columns], 1).tolist()
    return [Camera(*row) for row in rows]


def lower_cell(subpixels: Sequence[tuple[int, tuple[float, float], int]], period: tuple[int, int], taps: int) -> Cell:
    """Return the Cell of (channel, centre, kind) subpixels, centres in panel pixels from the cell's corner."""
    channel = np.array([s[0] for s in subpixels], np.int64)
    centre = np.array([s[1] for s in subpixels], np.float64).reshape(-1, 2)
    kind = np.array([s[2] for s in subpixels], np.int64)
    pixel = np.floor(centre).astype(np.int64)
    return Cell(np.array(period, np.int64), channel, kind, centre, pixel, taps)


def lower_shapes(
    edges: Tensor, period: tuple[int, int], harmonics: Sequence[tuple[int, int]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients, widths and skews of `record.Exposure`.

    Args:
        edges: (B, kinds, 2, 2) float64, two edge vectors of each kind, x then y, in panel pixels.
        harmonics: (k, l) pairs, k >= 0, conjugates and (0, 0) left out.
    """
    edges = edges / edges.new_tensor(period)
    n_k = max([k for k, _ in harmonics], default=0)
    n_l = max([abs(l) for _, l in harmonics], default=0)
    area = (edges[..., 0, 0] * edges[..., 1, 1] - edges[..., 0, 1] * edges[..., 1, 0]).abs()
    out = edges.new_zeros(*area.shape, n_k + 1, 2 * n_l + 1)
    if harmonics:
        pairs = edges.new_tensor(list(harmonics))
        waves = torch.sinc(edges @ pairs.mT)  # (B, kinds, edge, harmonic)
        k, l = pairs.long().unbind(1)
        out[..., k, l + n_l] = 2 * area[..., None] * waves.prod(-2)
    out[..., 0, n_l] = area
    long, short = edges.abs().amax(-2), edges.abs().amin(-2)
    return out.numpy(), long.contiguous().numpy(), (short.square() / 12).numpy()


def lower_sites(
    rows: Tensor, cols: Tensor, size: tuple[int, int], cfa: Sequence[tuple[int, int, tuple[int, ...]]]
) -> Sites:
    """Return the Sites of a sensor that is read at photo coordinates rows and cols.

    Args:
        cfa: (row, column, channels) of each site of a cell, in the order of the planes.
    """
    planes = [(r, c, channel) for r, c, channels in cfa for channel in channels]
    step = math.isqrt(len(cfa))
    row, col, channel = (np.array(values, np.int64) for values in zip(*planes, strict=True))
    return Sites((rows - size[0] / 2).numpy(), (cols - size[1] / 2).numpy(), step, row, col, channel)


def lower_keys(seeds: Tensor) -> np.ndarray:
    """Return the keys of seeds (B,) int64: (B, 2) uint32."""
    return torch.stack(keys(seeds), 1).numpy().view(np.uint32)


def lower_views(matrix: Tensor, size: tuple[int, int]) -> np.ndarray:
    """Return (B, 3, 3) homographies (B, 3, 3) from image to ideal photo coordinates, both about the centre."""
    h, w = size
    there = matrix.new_tensor([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    back = matrix.new_tensor([[1, 0, -w / 2], [0, 1, -h / 2], [0, 0, 1]])
    return (back @ matrix @ there).contiguous().numpy()
