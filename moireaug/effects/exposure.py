"""Exposure: panel light integrated over each sensor pixel's aperture and the lens's point spread.

One integral, `content * transmission` summed over a channel's subpixels, and several ways to it:

- `spectral` sums the few harmonics of the panel that the optics pass, each weighted by its modulation transfer: exact
  in the aperture, the lens and the view's local scale.
- `box` takes the overlap of subpixel and aperture in closed form, along x and y apart: for any pitch, exact where the
  view is upright and the lens sharp. For screens that are magnified beyond what a short series can follow.
- `supersample` averages points of the aperture and converges to the integral: the reference.
- `point` reads the panel at the pixel's centre, as the paper does.

The first two see the picture through `held`: what a panel pixel shows is held over its subpixel, so the picture changes
from one panel pixel to the next only while both are in the aperture. All are differentiable in the image; spectral and
box also in the view, and so in every field of a Shot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.effects.panel import Layout, Subpixel, coefficient, emits
from moireaug.effects.tone import clip


class Optics(NamedTuple):
    """What blurs a sensor pixel's view: (B,) each, in sensor pixels."""

    fill: Tensor
    blur: Tensor
    olpf: Tensor

    def variance(self) -> Tensor:
        """Of the point spread along one axis, in squared sensor pixels."""
        return self.fill.square() / 12 + self.blur.square() + self.olpf.square() / 4

    def transfer(self, fu: Tensor, fv: Tensor) -> Tensor:
        """Modulation transfer at cycles per sensor pixel (B, ...): a square aperture, a Gaussian spread, and a low-pass
        filter that doubles the picture along both axes."""
        fill, blur, olpf = (t.reshape(-1, *[1] * (fu.ndim - 1)) for t in self)
        spread = torch.exp(-2 * math.pi**2 * blur.square() * (fu.square() + fv.square()))
        doubled = torch.cos(math.pi * olpf * fu) * torch.cos(math.pi * olpf * fv)
        return torch.sinc(fill * fu) * torch.sinc(fill * fv) * spread * doubled

    def quantiles(self, n: int) -> Tensor:
        """The n mid-quantiles of the light along one axis, in sensor pixels: (B, n) float64.

        Equal weights at these points integrate any smooth light; without blur they are an even lattice.
        """
        target = ((torch.arange(n, dtype=torch.float64, device=self.fill.device) + 0.5) / n).expand(len(self.fill), n)
        half, sigma, olpf = self.fill[:, None] / 2, self.blur[:, None].clamp(min=1e-6), self.olpf[:, None] / 2

        def integral(z: Tensor) -> Tensor:  # of the normal distribution function
            return z * torch.special.ndtr(z) + torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)

        def below(x: Tensor) -> Tensor:
            return (integral((x + half) / sigma) - integral((x - half) / sigma)) * sigma / (2 * half)

        high = (half + olpf + 9 * sigma).expand_as(target)
        low = -high
        for _ in range(60):
            mid = (low + high) / 2
            under = (below(mid - olpf) + below(mid + olpf)) / 2 < target
            low, high = torch.where(under, mid, low), torch.where(under, high, mid)
        return (low + high) / 2


def shown(image: Tensor, x: Tensor, y: Tensor, dark: bool) -> Tensor:
    """Channels of the picture (B, C, H, W) at x, y (B, h or 1, w or 1), which go from -1 at its left and upper edge to
    1: (B, C, h, w). Bilinear between pixel centres; past the edges the outermost pixel, or dark."""
    # a view of planes: ten times as fast on CPU as to stack along the last axis
    grid = torch.stack(torch.broadcast_tensors(x.to(image.dtype), y.to(image.dtype)), 1).movedim(1, -1)
    content = F.grid_sample(image, grid, padding_mode="border", align_corners=False)
    return content * ((x >= -1) & (x < 1) & (y >= -1) & (y < 1))[:, None] if dark else content


def on_screen(at: Tensor, width: Tensor) -> Tensor:
    """Share of an aperture around `at`, `width` wide, that sees the picture, which goes from -1 to 1."""
    return ((at + width / 2).clamp(max=1) - (at - width / 2).clamp(min=-1)).clamp(min=0) / width


def on_picture(x: Tensor, y: Tensor, image: Tensor) -> tuple[Tensor, Tensor]:
    """Image coordinates as `shown` takes them."""
    return x * (2 / image.shape[-1]) - 1, y * (2 / image.shape[-2]) - 1


def footprint(jacobian: Tensor, pitch: Tensor, optics: Optics) -> Tensor:
    """Width along the panel's x and y of the box that spreads light as aperture and lens do.

    Args:
        jacobian: (B, ..., 2, 2), image coordinates by photo coordinates.
        pitch: (B,) panel pixels per image pixel over sensor pixels per photo pixel.

    Returns:
        (B, ..., 2) in panel pixels.
    """
    scale = pitch * (12 * optics.variance()).sqrt()
    return jacobian.norm(dim=-1) * scale.reshape(-1, *[1] * (jacobian.ndim - 2))


def unheld(footprint: Tensor, width: Tensor, period: int, alpha: Tensor) -> Tensor:
    """The variance that `held` leaves out, in squared image pixels: (B,).

    Where both neighbours are always in the aperture, that of the aperture and the subpixel; else that of going between
    them. Where panel and image pixels coincide the bilinear look-up has part of it.
    """
    same = (alpha == 1).to(alpha.dtype)
    share = (footprint + width) / period - 1  # of the way from one subpixel to the next with both in the aperture
    always = (footprint.square() + width.square()) / 12 - same / 6
    sometimes = share.clamp(min=0) * (period**2 / 6) * (1 - same)
    return (torch.where(share < 1, sometimes, always) / alpha.square()).clamp(min=0)


def slope(footprint: Tensor, width: Tensor) -> Tensor:
    """How steeply the picture changes between two subpixels, which it does while both are in the aperture: 1 where they
    always are, without bound where they never are. Both arguments in cells."""
    return 1 / (footprint + width - 1).clamp(min=1e-3, max=1)


def held(q: Tensor, slope: Tensor, offset: Tensor) -> Tensor:
    """Where the picture is looked up: on the nearest subpixel, and between two as steeply as `slope` says.

    Args:
        q: position in cells along an axis, whole where a subpixel of the channel has its centre.
        slope: (B, h or 1, w or 1), as from `slope`. offset: (1 - slope) / 2.
    """
    whole = q.floor().detach()
    return whole + clip(torch.addcmul(offset, q - whole, slope))


def amplitudes(
    subpixel: Subpixel,
    period: tuple[int, int],
    harmonics: Sequence[tuple[int, int]],
    jacobian: Tensor,
    pitch: Tensor,
    optics: Optics,
    lit: Tensor,
) -> Tensor:
    """Each harmonic's amplitude on a lattice of the photo: (B, harmonics, h, w).

    Args:
        subpixel, period: whose, and of which cell. harmonics: (k, l) pairs, (0, 0) and conjugates left out.
        jacobian, pitch, optics: as in `footprint`. lit: (B,).
    """
    (px, py), out = period, []
    j, lit = jacobian * pitch[:, None, None, None, None], lit[:, None, None]
    for k, l in harmonics:
        fu, fv = (k / px * j[..., 0, i] + l / py * j[..., 1, i] for i in (0, 1))
        out.append(2 * coefficient(subpixel, period, k, l, lit) * optics.transfer(fu, fv))
    return torch.stack(out, 1)


def spectral(q: tuple[Tensor, Tensor], mean: Tensor, harmonics: Sequence[tuple[int, int]], amplitude: Tensor) -> Tensor:
    """mean + sum of amplitude * cos(2 pi (k q_x + l q_y)): a subpixel's light through the optics, (B, h, w).

    Args:
        q: positions in cells from the subpixel's centre, (B, h or 1, w or 1) each.
        mean: (B, 1, 1), the share of the cell that emits. harmonics, amplitude: as from `amplitudes`.
    """
    light = mean
    for i, (k, l) in enumerate(harmonics):
        if q[0].dtype == amplitude.dtype:
            parts = [t * (2 * math.pi * n) for n, t in zip((k, l), q, strict=True) if n]
            phase = parts[0] if len(parts) == 1 else parts[0] + parts[1]
        else:
            # whole cycles are dropped before the cast, so that the phase keeps its digits far from the origin
            cycles = k * q[0] + l * q[1]
            phase = (cycles - cycles.detach().floor()).to(amplitude.dtype) * (2 * math.pi)
        light = torch.addcmul(light, torch.cos(phase), amplitude[:, i])
    return light


def edges(jacobian: Tensor, pitch: Tensor, optics: Optics) -> tuple[Tensor, Tensor]:
    """Aperture and lens along the panel's x and y as a box and a Gaussian around it: width and standard deviation, each
    (B, ..., 2) in panel pixels. The box is the aperture's longer side; the rest is in the Gaussian."""
    shape = [-1] + [1] * (jacobian.ndim - 2)
    scale, fill = pitch.reshape(shape), optics.fill.reshape(shape)
    long, short = jacobian.abs().amax(-1) * scale, jacobian.abs().amin(-1) * scale
    beside = (optics.blur.square() + optics.olpf.square() / 4).reshape(shape)
    rest = short.square() * (fill.square() / 12 + beside) + long.square() * beside
    return long * fill, rest.clamp(min=1e-24).sqrt()


def covered(q: Tensor, box: Tensor, sigma: Tensor, width: Tensor) -> Tensor:
    """Share of the light around q that comes from subpixels `width` wide at every whole number; all in cells.

    The box is integrated in closed form, and the Gaussian by the three points that are exact to the fifth moment, as
    long as it is narrower than a subpixel.
    """

    def up_to(z: Tensor) -> Tensor:
        whole = z.round().detach()
        return torch.addcmul((z - whole).clamp(-half, half), whole, width)

    half, aside, light = width / 2, math.sqrt(3) * sigma, 0.0
    for weight, shift in ((1 / 6, -aside), (2 / 3, 0.0), (1 / 6, aside)):
        light = light + weight * (up_to(q + (shift + box / 2)) - up_to(q + (shift - box / 2)))
    return light / box


def point(
    plane: Tensor, channel: int, x: Tensor, y: Tensor, *, layout: Layout, alpha: Tensor, lit: Tensor, dark: bool
) -> Tensor:
    """The panel's raster of subpixels at image coordinates x, y (B, h, w), bilinear: the paper's steps 2 and 3.

    Where two raster rows or columns show different panel pixels, the picture is looked up between these: as exact as
    the paper's own interpolation where image pixels are a whole odd number of panel pixels wide, as they are there.

    Args:
        plane: (B, 1, H, W), what is shown in this channel. alpha, lit: (B,) fields of Panel.
    """
    total = torch.zeros_like(x, dtype=plane.dtype)
    a, (h, w) = alpha.to(x.dtype)[:, None, None], plane.shape[-2:]
    for s in layout.of(channel):
        across, px = _raster(x * a, s.x0, s.x1, layout.raster, layout.period[0], a * w if dark else None)
        down, py = _raster(y * a, s.y0, s.y1, layout.raster, layout.period[1], a * h if dark else None)
        content = shown(plane, *on_picture(px / a, py / a, plane), dark=False)[:, 0]
        total = total + content * (across * down).to(plane.dtype)
    return total * lit.to(plane.dtype)[:, None, None]


def _raster(at: Tensor, low: float, high: float, n: int, period: int, end: Tensor | None) -> tuple[Tensor, Tensor]:
    """Along one axis, the light at a position that comes from a rectangle from `low` to `high`, by way of the two
    nearest of n raster subpixels a panel pixel, and where it comes from; positions in panel pixels. With an `end` it is
    dark outside of 0 to there."""
    at = at * n - 0.5
    left = at.floor().detach()
    second = at - left
    first = 1 - second
    if (low, high) != (0, period):
        place = left % (n * period)
        first = first * _lies_in(place, low * n, high * n)
        second = second * _lies_in((place + 1) % (n * period), low * n, high * n)
    here, there = ((left + k + 0.5).div(n).floor() + 0.5 for k in (0, 1))
    if end is not None:
        first, second = (t * ((p >= 0) & (p < end)) for t, p in ((first, here), (second, there)))
    light = first + second
    # both in one panel pixel, or the second in the next
    return light, here + (there - here) * second / light.clamp(min=1e-12)


def _lies_in(column: Tensor, low: float, high: float) -> Tensor:
    """Share of each raster column, given by its left edge, that lies between `low` and `high`."""
    return ((column + 1).clamp(max=high) - column.clamp(min=low)).clamp(min=0)


def supersample(
    plane: Tensor, channel: int, x: Tensor, y: Tensor, *, layout: Layout, alpha: Tensor, lit: Tensor, dark: bool
) -> Tensor:
    """What the panel emits at one point of each aperture, arguments as in `point`; the caller averages over points."""
    a = alpha.to(x.dtype)[:, None, None]
    px, py = x * a, y * a
    content = shown(plane, *on_picture((px.floor() + 0.5) / a, (py.floor() + 0.5) / a, plane), dark)[:, 0]
    return content * emits(layout, channel, px, py, lit.to(x.dtype)[:, None, None]).to(plane.dtype)


def golden(n: int) -> list[tuple[int, int]]:
    """n * n points of the unit square as ranks (i, k) along both axes: no two share a row or a column, and the golden
    ratio keeps them even whatever direction an edge cuts them in. Twice to four times as accurate as a square grid."""
    order = sorted(range(n * n), key=lambda i: i * 0.6180339887498949 % 1)
    return list(enumerate(order))
