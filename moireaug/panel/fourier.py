"""The Fourier series of a unit cell, in closed form."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.scene.layout import Layout, Subpixel


def coefficient(
    subpixel: Subpixel,
    period: tuple[int, int],
    k: Tensor | float,
    l: Tensor | float,
    width: Tensor,
    height: Tensor,
) -> Tensor:
    """Return the Fourier coefficient (k, l) of a subpixel's mask about its own centre, where it is
    real.

    1 / (Px Py) * integral of mask(x, y) exp(-2 pi i (k x / Px + l y / Py)), which for a
    parallelogram is its share of the cell times a sinc along each edge. For the RGB stripe: sin(pi
    k / 3) / (pi k).

    Args:
        k, l: harmonics, numbers or tensors.
        width, height: shares of its two edges that emit, as from `emitting_share`; the rest is
            black matrix.
    """
    (px, py), (ax, ay), (dx, dy) = period, subpixel.across, subpixel.down
    along = torch.sinc((k * (ax / px) + l * (ay / py)) * width)
    beside = torch.sinc((k * (dx / px) + l * (dy / py)) * height)
    return width * height * (subpixel.area / (px * py)) * along * beside


def mean_light(layout: Layout, channel: int, width: Tensor, height: Tensor) -> Tensor:
    """Return the share of the panel's area that emits one channel, (B,)."""
    share = torch.zeros_like(width)
    for subpixel in layout.of(channel):
        share = share + width * height * (subpixel.area / (layout.period[0] * layout.period[1]))
    return share


def emitting_share(panel) -> tuple[Tensor, Tensor]:
    """Return the shares of a subpixel's two edges that emit: (B,) each, for a drawn Panel."""
    side = panel.lit.sqrt()
    return side * panel.lit_x, side * panel.lit_y
