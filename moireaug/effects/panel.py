"""The panel: which subpixel of which colour emits where.

A layout is data: rectangles inside a unit cell. Everything else is derived from them: the Fourier coefficients that the
spectral exposure sums, the indicator that supersampling reads, and the raster of subpixels that the paper samples.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import torch
from torch import Tensor

RED, GREEN, BLUE = 0, 1, 2


@dataclass(frozen=True)
class Layout:
    """A unit cell of subpixels.

    Args:
        subpixels: (channel, x0, y0, x1, y1) rectangles, in panel pixels from the cell's upper left corner.
        period: width and height of the cell, in panel pixels.
        raster: columns and rows of the finest even raster that the rectangles fill, per panel pixel.
    """

    subpixels: tuple[tuple[int, float, float, float, float], ...]
    period: tuple[int, int] = (1, 1)
    raster: tuple[int, int] = (3, 3)


def stripes(*channels: int) -> Layout:
    """Full-height vertical stripes, left to right."""
    n = len(channels)
    return Layout(tuple((c, i / n, 0.0, (i + 1) / n, 1.0) for i, c in enumerate(channels)), raster=(n, n))


LAYOUTS: dict[str, Layout] = {
    "rgb_stripe": stripes(RED, GREEN, BLUE),
    "bgr_stripe": stripes(BLUE, GREEN, RED),
    # one package with three dies one above the other, as in surface-mounted LEDs
    "led": Layout(tuple((c, 0.25, 0.25 + c / 6, 0.75, 0.25 + (c + 1) / 6) for c in (RED, GREEN, BLUE)), raster=(4, 12)),
}


def harmonic(layout: Layout, channel: int, k: int, l: int, lit: float | Tensor) -> tuple[float | Tensor, complex]:
    """Fourier coefficient (k, l) of a channel's mask, as (modulus-like real factor, constant phasor).

    a[k, l] = 1/(Px Py) * integral over the cell of mask(x, y) exp(-2 pi i (k x / Px + l y / Py)).

    Rectangles of one channel share their size in every layout here, so the lit fraction only scales one common real
    factor, and the phasor stays a constant. For the RGB stripe: sin(pi k / 3) / (pi k) at the phase (c + 1/2) / 3.
    """
    px, py = layout.period
    boxes = [s[1:] for s in layout.subpixels if s[0] == channel]
    width, height = boxes[0][2] - boxes[0][0], boxes[0][3] - boxes[0][1]
    phasor = sum(
        cmath.exp(-2j * math.pi * (k * (x0 + x1) / 2 / px + l * (y0 + y1) / 2 / py)) for x0, y0, x1, y1 in boxes
    )
    side = lit**0.5  # a rectangle shrinks about its own centre, along both axes alike
    return _box(k * width / px, side) * _box(l * height / py, side) * (width * height / (px * py)), phasor


def _box(x: float, side: float | Tensor) -> float | Tensor:
    """side * sinc(x * side), for a number or a tensor."""
    if isinstance(side, Tensor):
        return side * torch.sinc(x * side)
    t = math.pi * x * side
    return side * (math.sin(t) / t if t else 1.0)


def emits(layout: Layout, channel: int, x: Tensor, y: Tensor, lit: Tensor) -> Tensor:
    """1 where a channel's subpixel emits at panel position (x, y), in panel pixels, else 0. Not differentiable."""
    px, py = layout.period
    x, y = x % px, y % py
    side = lit**0.5
    mask = torch.zeros_like(x)
    for c, x0, y0, x1, y1 in layout.subpixels:
        if c == channel:
            across = (x - (x0 + x1) / 2).div_((x1 - x0) / 2)
            down = (y - (y0 + y1) / 2).div_((y1 - y0) / 2)
            mask += (across >= -side) & (across < side) & (down >= -side) & (down < side)
    return mask


def raster_table(layout: Layout, channel: int) -> Tensor:
    """Share of each raster subpixel that a fully lit channel fills: (rows * Py, columns * Px) float64."""
    (px, py), (nx, ny) = layout.period, layout.raster
    left = torch.arange(nx * px, dtype=torch.float64) / nx
    top = torch.arange(ny * py, dtype=torch.float64) / ny
    table = torch.zeros(ny * py, nx * px, dtype=torch.float64)
    for c, x0, y0, x1, y1 in layout.subpixels:
        if c == channel:
            across = ((left + 1 / nx).clamp(max=x1) - left.clamp(min=x0)).clamp(min=0) * nx
            down = ((top + 1 / ny).clamp(max=y1) - top.clamp(min=y0)).clamp(min=0) * ny
            table += down[:, None] * across[None, :]
    return table
