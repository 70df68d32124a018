"""The light that a panel emits: the Fourier series of its unit cell, in closed form, and where its
subpixels are."""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moireaug.common.numeric import array_like
from moireaug.scene.drawn_parts import DrawnPanel
from moireaug.scene.layout import Layout
from moireaug.scene.shot_geometry import ShotGeometry
from moireaug.scene.subpixel import Subpixel

Orders = tuple[int, int]  # of a harmonic along x and y: cycles per cell


def coefficient(
    subpixel: Subpixel, k: Tensor | float, l: Tensor | float, width: Tensor, height: Tensor
) -> Tensor:
    """Return the Fourier coefficient (k, l) of a subpixel's mask about its own centre, where it is
    real.

    1 / (Px Py) * integral of mask(x, y) exp(-2 pi i (k x / Px + l y / Py)), P its period, which for
    a parallelogram is its share of the cell times a sinc along each edge. For the RGB stripe:
    sin(pi k / 3) / (pi k).

    Args:
        k, l: harmonics, numbers or tensors.
        width, height: shares of its two edges that emit, as from `emitting_share`; the rest is
            black matrix.
    """
    along, beside = cycles_along_edges(subpixel, k, l)
    area = width * height * subpixel.density
    return area * torch.sinc(along * width) * torch.sinc(beside * height)


def cycles_along_edges(subpixel: Subpixel, k: Any, l: Any) -> tuple[Any, Any]:
    """Return the cycles of harmonics (k, l) of a subpixel's own cell along its two edges; of
    numbers, tensors or arrays."""
    (px, py), (ax, ay), (dx, dy) = subpixel.period, subpixel.across, subpixel.down
    return k * (ax / px) + l * (ay / py), k * (dx / px) + l * (dy / py)


def own_orders(subpixel: Subpixel, layout: Layout, k: Any, l: Any) -> tuple[Any, Any, Any]:
    """Return harmonics (k, l) of a layout's cell in cycles per cell of a subpixel's own, and
    whether the subpixel has them: one that repeats twice in the layout's cell has every second
    harmonic. Of numbers, tensors or arrays."""
    across, down = (whole // own for whole, own in zip(layout.period, subpixel.period, strict=True))
    return k / across, l / down, (k % across == 0) & (l % down == 0)


def mean_light(layout: Layout, width: Any, height: Any) -> Any:
    """Return the share of the panel's area that emits each channel, (B, 3), from the shares of a
    subpixel's edges that do, tensors or arrays."""
    density = [sum(subpixel.density for subpixel in layout.of(channel)) for channel in range(3)]
    return (width * height)[:, None] * array_like(density, width)


def mean_light_of(shot: ShotGeometry) -> Any:
    """Return the share of a shot's panel's area that emits each channel, (B, 3)."""
    return mean_light(shot.scene.panel.cell, *emitting_share(shot.panel))


def emitting_share(panel: DrawnPanel) -> tuple[Any, Any]:
    """Return the shares of a subpixel's two edges that emit: (B,) each, of the panel's library."""
    side = panel.lit**0.5
    return side * panel.lit_x, side * panel.lit_y


def amplitudes_of(shot: ShotGeometry, harmonics: tuple[Orders, ...]) -> tuple[Any, ...]:
    """Return twice the Fourier coefficients of each channel's light about the corner of the cell,
    (3, K, B) float64 each, real and imaginary part, of the shot's library."""
    xp, (width, height) = shot.xp, emitting_share(shot.panel)
    channels, table = _waves(shot.scene.panel.cell, harmonics)
    waves = torch.from_numpy(table).to(width.device) if xp is torch else table
    along, beside, density, cosine, sine = waves
    amplitude = width * height * density * xp.sinc(along * width) * xp.sinc(beside * height)
    # not index_add, whose threads a forked worker would wait for forever
    real, imaginary = amplitude * cosine, amplitude * -sine
    return tuple(xp.stack([part[s].sum(0) for s in channels]) for part in (real, imaginary))


@functools.lru_cache(maxsize=64)
def _waves(layout: Layout, harmonics: tuple[Orders, ...]) -> tuple[list[slice], np.ndarray]:
    """Return what `amplitudes_of` reads of a layout's S subpixels: which are each channel's, and a
    table (5, S, K, 1) float64 of the harmonics' cycles along both edges, the subpixels' density,
    and twice the cosine and sine of the phase at their centres, 0 where they lack a harmonic."""
    orders = np.array(harmonics, np.float64).reshape(-1, 2, 1)
    rows = []
    channels = [layout.of(channel) for channel in range(3)]
    for subpixel in itertools.chain(*channels):
        k, l, has = own_orders(subpixel, layout, orders[:, 0], orders[:, 1])
        turns = k * (subpixel.centre[0] / subpixel.period[0])
        turns = turns + l * (subpixel.centre[1] / subpixel.period[1])
        cosine, sine = 2 * has * np.cos(2 * math.pi * turns), 2 * has * np.sin(2 * math.pi * turns)
        density = np.full_like(k, subpixel.density)
        rows.append(np.stack([*cycles_along_edges(subpixel, k, l), density, cosine, sine]))
    ends = list(itertools.accumulate(map(len, channels), initial=0))
    return list(itertools.starmap(slice, itertools.pairwise(ends))), np.stack(rows, 1)


def cell_of(subpixel: Subpixel, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Return which copy of a subpixel is nearest to panel position (x, y): whole cells along both
    axes."""
    (cx, cy), (px, py) = subpixel.centre, subpixel.period
    # not `round`, which leaves every second border between two copies to neither
    across = ((x - cx) / px + 0.5).floor()
    down = ((y - cy) / py + 0.5).floor()
    return across, down


def emits(subpixel: Subpixel, x: Tensor, y: Tensor, width: Tensor, height: Tensor) -> Tensor:
    """Return 1 where a copy of a subpixel emits at panel position (x, y), in panel pixels, else 0.
    Not differentiable.

    Args:
        width, height: shares of its two edges that emit, as from `emitting_share`.
    """
    column, row = cell_of(subpixel, x, y)
    right = x - column * subpixel.period[0] - subpixel.centre[0]
    below = y - row * subpixel.period[1] - subpixel.centre[1]
    (ax, ay), (dx, dy) = subpixel.across, subpixel.down
    turn = ax * dy - ay * dx
    s = (right * dy - below * dx) / turn  # -1/2 to 1/2 along each edge
    t = (below * ax - right * ay) / turn
    return ((s >= -width / 2) & (s < width / 2) & (t >= -height / 2) & (t < height / 2)).to(x.dtype)
