"""The Fourier series of a unit cell, in closed form."""

from __future__ import annotations

import math
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


def amplitudes_of(
    layout: Layout, channel: int, harmonics: tuple[tuple[int, int], ...], panel
) -> tuple[Tensor, Tensor]:
    """Return twice the Fourier coefficients of one channel's light about the corner of the cell,
    (K, B) float64 each, real and imaginary part."""
    width, height = emitting_share(panel)
    orders = width.new_tensor(harmonics).reshape(-1, 2, 1)
    real = imaginary = width.new_zeros(len(harmonics), len(width))
    for subpixel in layout.of(channel):
        k, l, own = _own_orders(orders, subpixel, layout)
        amplitude = 2 * own * coefficient(subpixel, k, l, width, height)
        turns = k * (subpixel.centre[0] / subpixel.period[0])
        turns = turns + l * (subpixel.centre[1] / subpixel.period[1])
        real = real + amplitude * torch.cos(2 * math.pi * turns)
        imaginary = imaginary - amplitude * torch.sin(2 * math.pi * turns)
    return real, imaginary


def _own_orders(
    orders: Tensor, subpixel: Subpixel, layout: Layout
) -> tuple[Tensor, Tensor, Tensor]:
    """Return a layout's orders in cycles per cell of a subpixel, and 1 where it has them, else
    0."""
    across, down = (whole // own for whole, own in zip(layout.period, subpixel.period, strict=True))
    k, l = orders[:, 0] / across, orders[:, 1] / down
    own = ((k == k.round()) & (l == l.round())).to(k.dtype)
    return k, l, own
