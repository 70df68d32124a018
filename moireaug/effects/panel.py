"""The panel: which subpixel of which colour emits where, and what picture its pixels hold.

A layout is data: rectangles inside a unit cell. Everything else is derived from them: the Fourier coefficients that the
spectral exposure sums, the edges that the box exposure integrates between, the indicator that supersampling reads, and
the raster of subpixels that the paper samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

RED, GREEN, BLUE = 0, 1, 2
MOST_RASTER = 24  # along a panel pixel, where no smaller number fits the rectangles


@dataclass(frozen=True)
class Subpixel:
    """One rectangle of a unit cell that emits one channel, in panel pixels from the cell's upper left corner."""

    channel: int
    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> tuple[float, float]:
        # rounded, so that three thirds are one width: what depends on it alone is computed once
        return round(self.x1 - self.x0, 12), round(self.y1 - self.y0, 12)

    @property
    def centre(self) -> tuple[float, float]:
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    @property
    def pixel(self) -> tuple[float, float]:
        """Centre of the panel pixel whose value it shows: the one that its own centre lies in."""
        return math.floor(self.centre[0]) + 0.5, math.floor(self.centre[1]) + 0.5


@dataclass(frozen=True)
class Layout:
    """A unit cell of subpixels, repeated over the panel.

        Panel(layout=Layout(((0, 0, 0, 0.5, 1), (1, 0.5, 0, 1, 0.5), (2, 0.5, 0.5, 1, 1))))

    Args:
        subpixels: (channel, x0, y0, x1, y1) rectangles, channel 0 red, 1 green, 2 blue, in panel pixels from the
            cell's upper left corner, x right, y down. Rectangles of one channel must not overlap.
        period: width and height of the cell, in whole panel pixels.

    Raises:
        ValueError, TypeError: a rectangle that is empty or leaves the cell, an unknown channel, no rectangle at all.
    """

    subpixels: tuple[tuple[int, float, float, float, float], ...]
    period: tuple[int, int] = (1, 1)

    def __post_init__(self) -> None:
        for name in ("subpixels", "period"):
            if not isinstance(getattr(self, name), (tuple, list)):
                raise TypeError(f"Layout.{name} must be a tuple; got {getattr(self, name)!r}.")
        object.__setattr__(self, "period", tuple(self.period))
        object.__setattr__(self, "subpixels", tuple(tuple(s) for s in self.subpixels))
        if len(self.period) != 2 or any(type(p) is not int or not 1 <= p <= 16 for p in self.period):
            raise ValueError(f"Layout.period must be two whole numbers of panel pixels in [1, 16]; got {self.period}.")
        if not self.subpixels:
            raise ValueError("Layout.subpixels must hold at least one (channel, x0, y0, x1, y1) rectangle; got none.")
        for s in self.subpixels:
            if len(s) != 5 or any(isinstance(v, bool) or not isinstance(v, Real) for v in s):
                raise TypeError(f"Layout.subpixels must be (channel, x0, y0, x1, y1) numbers; got {s!r}.")
            c, x0, y0, x1, y1 = s
            if c not in (RED, GREEN, BLUE):
                raise ValueError(f"a subpixel's channel must be 0 (red), 1 (green) or 2 (blue); got {c!r} in {s!r}.")
            if not (0 <= x0 < x1 <= self.period[0] and 0 <= y0 < y1 <= self.period[1]):
                raise ValueError(
                    f"a subpixel must have x0 < x1 and y0 < y1 inside its cell of {self.period[0]} x {self.period[1]} "
                    f"panel pixels; got {s!r}."
                )
        object.__setattr__(self, "subpixels", tuple((int(c), *edges) for c, *edges in self.subpixels))
        for i, a in enumerate(self.subpixels):
            for b in self.subpixels[:i]:
                if a[0] == b[0] and a[1] < b[3] and b[1] < a[3] and a[2] < b[4] and b[2] < a[4]:
                    raise ValueError(f"subpixels of one channel must not overlap; got {b!r} and {a!r}.")

    def of(self, channel: int) -> tuple[Subpixel, ...]:
        """The subpixels of one channel."""
        return tuple(Subpixel(*s) for s in self.subpixels if s[0] == channel)

    @property
    def raster(self) -> int:
        """Raster subpixels along each side of a panel pixel, as few as the rectangles fill evenly; at most 24."""
        edges = [v for s in self.subpixels for v in s[1:]]
        fits = (n for n in range(1, MOST_RASTER + 1) if all(abs(e * n - round(e * n)) < 1e-6 for e in edges))
        return next(fits, MOST_RASTER)


def as_layout(value: Layout | str | dict[str, Any]) -> Layout:
    """A Layout from a Layout, a key of `LAYOUTS` or a dict of its two fields."""
    if isinstance(value, dict):
        return Layout(**value)
    return value if isinstance(value, Layout) else LAYOUTS[value]


def stripes(*channels: int) -> Layout:
    """Full-height vertical stripes, left to right."""
    n = len(channels)
    return Layout(tuple((c, i / n, 0.0, (i + 1) / n, 1.0) for i, c in enumerate(channels)))


LAYOUTS: dict[str, Layout] = {
    "rgb_stripe": stripes(RED, GREEN, BLUE),
    "bgr_stripe": stripes(BLUE, GREEN, RED),
    # a stripe panel turned on its side: each pixel is a column of three bars
    "rgb_column": Layout(tuple((c, 0.0, c / 3, 1.0, (c + 1) / 3) for c in (RED, GREEN, BLUE))),
    # PenTile RGBG: two pixels share a red and a blue subpixel, twice as wide as each pixel's own green
    "pentile": Layout(((0, 0, 0, 2 / 3, 1), (1, 2 / 3, 0, 1, 1), (2, 1, 0, 5 / 3, 1), (1, 5 / 3, 0, 2, 1)), (2, 1)),
    # one package with three dies one above the other, as in surface-mounted LEDs
    "led": Layout(tuple((c, 0.25, 0.25 + c / 6, 0.75, 0.25 + (c + 1) / 6) for c in (RED, GREEN, BLUE))),
    # every pixel emits all colours over its whole area, as a print or a projection does: no moiré unless lit < 1
    "even": Layout(tuple((c, 0.0, 0.0, 1.0, 1.0) for c in (RED, GREEN, BLUE))),
}


def box(x: float, side: float | Tensor) -> float | Tensor:
    """side * sinc(x * side), for a number or a tensor."""
    if isinstance(side, Tensor):
        return side * torch.sinc(x * side)
    t = math.pi * x * side
    return side * (math.sin(t) / t if t else 1.0)


def coefficient(s: Subpixel, period: tuple[int, int], k: int, l: int, lit: float | Tensor) -> float | Tensor:
    """Fourier coefficient (k, l) of a subpixel's mask about the subpixel's own centre: real, of the shape of `lit`.

    1/(Px Py) * integral of mask(x, y) exp(-2 pi i (k x / Px + l y / Py)). A subpixel shrinks about its own centre,
    along both axes alike. For the RGB stripe: sin(pi k / 3) / (pi k).
    """
    (w, h), (px, py), side = s.width, period, lit**0.5
    return box(k * w / px, side) * box(l * h / py, side) * (w * h / (px * py))


def emits(layout: Layout, channel: int, x: Tensor, y: Tensor, lit: Tensor) -> Tensor:
    """1 where a channel's subpixel emits at panel position (x, y), in panel pixels, else 0. Not differentiable."""
    x, y = x % layout.period[0], y % layout.period[1]
    side = lit**0.5
    mask = torch.zeros_like(x)
    for s in layout.of(channel):
        (cx, cy), (w, h) = s.centre, s.width
        across, down = (x - cx).div_(w / 2), (y - cy).div_(h / 2)
        mask += (across >= -side) & (across < side) & (down >= -side) & (down < side)
    return mask


def spread(image: Tensor, across: Tensor, down: Tensor) -> Tensor:
    """Blur (B, 3, H, W) by so much variance along x and y, (B, 3) each in squared image pixels and in [0, 1/2].

    Half the variance goes to each neighbour: exact for a picture's curvature, which is what a small aperture sees.
    """
    across, down = (v.to(image.dtype)[:, :, None, None] for v in (across, down))
    wide = F.pad(image, (1, 1, 1, 1), mode="replicate")
    wide = torch.addcmul(wide[..., 1:-1] * (1 - across), wide[..., :-2] + wide[..., 2:], across / 2)
    return torch.addcmul(wide[..., 1:-1, :] * (1 - down), wide[..., :-2, :] + wide[..., 2:, :], down / 2)


def prefilter(image: Tensor, variance: Tensor, levels: int) -> Tensor:
    """Blur (B, 3, H, W) by a variance (B, 1, H or 1, W or 1) in squared image pixels that differs from place to place.

    A pyramid of `levels` halvings; between two of them the mix whose variance is right. What lies beyond the last has
    its variance.
    """
    size, out, below = image.shape[-2:], image, 0.0
    for j in range(1, levels + 1):
        small = [max(1, math.ceil(n / 2**j)) for n in size]
        coarse = F.interpolate(F.interpolate(image, size=small, mode="area"), size=size, mode="bilinear")
        above = 4**j / 4  # of a box of 2^j pixels and the bilinear interpolation between them
        share = ((variance - below) / (above - below)).clamp(0, 1).to(image.dtype)
        out, below = out + share * (coarse - out), above
    return out
