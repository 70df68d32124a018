"""The Fourier series of a unit cell, in closed form."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from moireaug.scene.layout import Layout
from moireaug.scene.subpixel import Subpixel

Orders = tuple[int, int]  # of a harmonic along x and y: cycles per cell
Numbers = TypeVar("Numbers", Tensor, np.ndarray)


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
    (px, py), (ax, ay), (dx, dy) = subpixel.period, subpixel.across, subpixel.down
    along = torch.sinc((k * (ax / px) + l * (ay / py)) * width)
    beside = torch.sinc((k * (dx / px) + l * (dy / py)) * height)
    return width * height * subpixel.density * along * beside


def own_orders(subpixel: Subpixel, layout: Layout, harmonics: Iterable[Orders]) -> list[Orders]:
    """Return those of a layout's harmonics that a subpixel has, in cycles per cell of its own: one
    that repeats twice in the layout's cell has every second harmonic."""
    across, down = (whole // own for whole, own in zip(layout.period, subpixel.period, strict=True))
    return [(k // across, l // down) for k, l in harmonics if k % across == 0 and l % down == 0]


def mean_light(layout: Layout, channel: int, width: Numbers, height: Numbers) -> Numbers:
    """Return the share of the panel's area that emits one channel, (B,), from the shares of a
    subpixel's edges that do."""
    return width * height * sum(subpixel.density for subpixel in layout.of(channel))


def emitting_share(panel) -> tuple[Tensor, Tensor]:
    """Return the shares of a subpixel's two edges that emit: (B,) each, for a drawn Panel."""
    side = panel.lit.sqrt()
    return side * panel.lit_x, side * panel.lit_y
