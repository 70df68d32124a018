"""Exposure: panel light integrated over each sensor pixel's aperture and the lens's point spread.

Three methods for one integral. `point` reads the panel at the pixel's centre, as the paper does; `supersample` averages
n x n points of the aperture and converges to the integral; `spectral` sums the panel's few harmonics that the optics
pass, each weighted by the modulation transfer at its local frequency. All take one colour plane `(B, 1, H, W)` of what
the panel shows and the image coordinates x, y `(B, h, w)` at which its sensor pixels look, and return `(B, h, w)`.
All are differentiable in the image; `spectral` also in the coordinates, the amplitudes and so in every field of a Shot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.effects.panel import Layout, emits, harmonic, raster_table


def shown(plane: Tensor, x: Tensor, y: Tensor, dark: bool) -> Tensor:
    """The picture at image coordinates, bilinear between pixel centres; past its edges dark, or its outermost pixel."""
    h, w = plane.shape[-2:]
    grid = torch.stack([x * (2 / w) - 1, y * (2 / h) - 1], -1).to(plane.dtype)
    content = F.grid_sample(plane, grid, padding_mode="border", align_corners=False)[:, 0]
    return content * ((x >= 0) & (x < w) & (y >= 0) & (y < h)) if dark else content


def transfer(fu: Tensor, fv: Tensor, fill: Tensor, blur: Tensor) -> Tensor:
    """Modulation transfer of a square aperture `fill` wide and a Gaussian spread, at cycles per sensor pixel."""
    spread = torch.exp(-2 * math.pi**2 * blur.square() * (fu.square() + fv.square()))
    return torch.sinc(fill * fu) * torch.sinc(fill * fv) * spread


def amplitudes(
    layout: Layout,
    harmonics: Sequence[tuple[int, int]],
    jacobian: Tensor,
    pitch: Tensor,
    fill: Tensor,
    blur: Tensor,
    lit: Tensor,
) -> Tensor:
    """Each harmonic's amplitude without its colour's phasor, on a lattice of the photo: (B, harmonics, h, w).

    Args:
        layout: the unit cell. harmonics: (k, l) pairs, (0, 0) and conjugates left out.
        jacobian: (B, h, w, 2, 2), image coordinates by photo coordinates.
        pitch: (B,) panel pixels per image pixel over sensor pixels per photo pixel.
        fill, blur, lit: (B,) fields of Sensor, Lens and Panel.
    """
    (px, py), out = layout.period, []
    j = jacobian * pitch[:, None, None, None, None]
    fill, blur, lit = (t[:, None, None] for t in (fill, blur, lit))
    for k, l in harmonics:
        fu, fv = (k / px * j[..., 0, i] + l / py * j[..., 1, i] for i in (0, 1))
        modulus, _ = harmonic(layout, 0, k, l, lit)
        out.append(2 * modulus * transfer(fu, fv, fill, blur))
    return torch.stack(out, 1)


def spectral(
    plane: Tensor, channel: int, x: Tensor, y: Tensor, *, layout: Layout, alpha: Tensor, lit: Tensor,
    dark: bool,
    harmonics: Sequence[tuple[int, int]], amplitude: Tensor | None,
) -> Tensor:  # fmt: skip
    """content * (a[0, 0] + sum of 2 Re a[k, l] MTF exp(2 pi i (k X / Px + l Y / Py))).

    Args:
        alpha, lit: (B,) fields of Panel.
        harmonics, amplitude: the pairs and their amplitudes, (B, n, h or 1, w or 1), as from `amplitudes`.
    """
    (px, py), dtype = layout.period, plane.dtype
    mean, phasor = harmonic(layout, channel, 0, 0, lit)
    light = (mean * phasor.real).to(dtype)[:, None, None]
    alpha = alpha.to(x.dtype)[:, None, None]
    for i, (k, l) in enumerate(harmonics):
        cycles = x * (alpha * (k / px)) if k else 0.0
        if l:
            cycles = cycles + y * (alpha * (l / py))
        _, phasor = harmonic(layout, channel, k, l, 1.0)
        if abs(phasor) < 1e-12:
            continue
        # whole cycles are dropped before the cast, so that the phase keeps its digits far from the origin
        turn = math.atan2(phasor.imag, phasor.real)
        wave = torch.cos((cycles - cycles.detach().floor()).to(dtype) * (2 * math.pi) + turn)
        light = light + wave * (amplitude[:, i] * abs(phasor))
    return shown(plane, x, y, dark) * light


def point(
    plane: Tensor, channel: int, x: Tensor, y: Tensor, *, layout: Layout, alpha: Tensor, lit: Tensor, dark: bool
) -> Tensor:
    """The panel's raster of subpixels at the pixel's centre, bilinear: the paper's steps 2 and 3."""
    nx, ny = layout.raster
    table = raster_table(layout, channel).to(x)
    alpha = alpha.to(x.dtype)[:, None, None]
    xs, ys = x * (alpha * nx) - 0.5, y * (alpha * ny) - 0.5
    left, top = xs.detach().floor(), ys.detach().floor()
    total = torch.zeros_like(x, dtype=plane.dtype)
    for column, across in ((left, 1 - (xs - left)), (left + 1, xs - left)):
        px = torch.div(column, nx, rounding_mode="floor")
        for row, down in ((top, 1 - (ys - top)), (top + 1, ys - top)):
            py = torch.div(row, ny, rounding_mode="floor")
            share = table[(row % table.shape[0]).long(), (column % table.shape[1]).long()]
            content = shown(plane, (px + 0.5) / alpha, (py + 0.5) / alpha, dark)
            total = total + content * (across * down * share).to(plane.dtype)
    return total * lit.to(plane.dtype)[:, None, None]


def supersample(
    plane: Tensor, channel: int, x: Tensor, y: Tensor, *, layout: Layout, alpha: Tensor, lit: Tensor, dark: bool
) -> Tensor:
    """What the panel emits at one point of each aperture; the caller averages over the aperture's points."""
    a = alpha.to(x.dtype)[:, None, None]
    px, py = x * a, y * a
    content = shown(plane, (px.floor() + 0.5) / a, (py.floor() + 0.5) / a, dark)
    return content * emits(layout, channel, px, py, lit.to(x.dtype)[:, None, None]).to(plane.dtype)


def aperture_points(n: int, fill: Tensor, blur: Tensor) -> Tensor:
    """The n mid-quantiles of light over a box `fill` wide spread by a Gaussian, in sensor pixels: (B, n) float64.

    Equal weights at these points integrate any smooth light over the aperture; without blur they are an even lattice.
    """
    target = ((torch.arange(n, dtype=torch.float64, device=fill.device) + 0.5) / n).expand(len(fill), n)
    half, sigma = fill[:, None] / 2, blur[:, None].clamp(min=1e-6)

    def integral(z: Tensor) -> Tensor:  # of the normal distribution function
        return z * torch.special.ndtr(z) + torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)

    low, high = -half - 9 * sigma, half + 9 * sigma
    low, high = low.expand_as(target), high.expand_as(target)
    for _ in range(60):
        mid = (low + high) / 2
        below = (integral((mid + half) / sigma) - integral((mid - half) / sigma)) * sigma / (2 * half) < target
        low, high = torch.where(below, mid, low), torch.where(below, high, mid)
    return (low + high) / 2
