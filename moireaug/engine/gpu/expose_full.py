"""Screen to raw by the panel's light over each sensor pixel's aperture and blur, in full readings:
the exposures "spectral" and "mean".

What a pixel sees of a subpixel is what the cells around show, weighted by their shares of the
pixel's view, times the sum of the subpixel's harmonics, each weighted by its transfer.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu import full_reading
from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.footprint import footprint, narrowing, share_between, tap_shares
from moireaug.engine.gpu.full_reading import Method
from moireaug.engine.gpu.panel import place_on_shown, weights_on_shown
from moireaug.engine.gpu.transfer import transfer, wave
from moireaug.engine.gpu.view import ALPHA
from moireaug.engine.lower.exposure_records import Camera, Exposure


class Subpixels(NamedTuple):
    """The subpixels of a panel's cell, of some kinds; see `exposure_records.Cell`.

    Args:
        colour, kind: (n,) int32. centre, pixel: (n, 2) float64, panel pixels, of the pixel its
            middle.
        period: (kinds, 2) float64, panel pixels. cells: its inverse.
        width, slant_variance: (B, kinds, 2) float32, see `footprint`.
        k, l: (terms,) float32, of harmonics, those of each kind together. first_term: (kinds + 1,)
            int32. amplitude: (B, terms) float32. mean: (B, kinds) float32.
        length, kinds, terms: how many there are.
    """

    colour: Any
    kind: Any
    centre: Any
    pixel: Any
    period: Any
    cells: Any
    width: Any
    slant_variance: Any
    k: Any
    l: Any
    first_term: Any
    amplitude: Any
    mean: Any
    length: int
    kinds: int
    terms: int


def expose(picture: Tensor, exposure: Exposure) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    return full_reading.expose(picture, exposure, _method_of(exposure))


def expose_back(grad: Tensor, picture: Tensor, exposure: Exposure) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings."""
    return full_reading.expose_back(grad, picture, exposure, _method_of(exposure))


def _method_of(e: Exposure) -> Method:
    cell, middle = e.cell, e.coefficients.shape[3] // 2
    amplitude = e.coefficients.copy()
    amplitude[:, :, 0, middle] = 0
    gain = e.cameras[:, Camera._fields.index("gain")].max(initial=1)
    strongest = np.abs(amplitude).max(0, initial=0)
    kind, k, l = np.nonzero(strongest > e.budget.harmonic_amplitude / gain)
    kinds = len(cell.period)
    subpixels = Subpixels(
        colour=cell.channel.astype(np.int32),
        kind=cell.kind.astype(np.int32),
        centre=cell.centre,
        pixel=cell.pixel + 0.5,
        period=cell.period.astype(np.float64),
        cells=1 / cell.period,
        width=e.widths.astype(np.float32),
        slant_variance=e.added_variance.astype(np.float32),
        k=k.astype(np.float32),
        l=(l - middle).astype(np.float32),
        first_term=np.searchsorted(kind, np.arange(kinds + 1)).astype(np.int32),
        amplitude=amplitude[:, kind, k, l].astype(np.float32),
        mean=e.coefficients[:, :, 0, middle].astype(np.float32),
        length=len(cell.channel),
        kinds=kinds,
        terms=len(k),
    )
    return Method(see, subpixels, *_spans(e))


def _spans(e: Exposure) -> list[int]:
    """Return how many columns and rows of pixels shown a pixel's cells take their light from, at
    most: a finer panel's pixels from two each."""
    alpha = np.maximum(e.cameras[:, Camera._fields.index("alpha")], 1)
    spans = []
    for period in e.cell.period.max(0):
        from_first_to_last = 2 * e.cell.radius * int(period) / int(alpha.min(initial=1))
        spans.append(math.ceil(from_first_to_last) + (2 if alpha.max(initial=1) > 1 else 1))
    return spans


@triton.jit
def _along_axis(
    position, by_u, by_v, size, count, i, image, reading, screen, subpixels,
    AXIS: tl.constexpr, SPAN: tl.constexpr, TAPS: tl.constexpr, DARK: tl.constexpr,
):  # fmt: skip
    """Return, along one axis, how far pixels look past the nearest subpixel i, in cells, the first
    pixel shown that they see, and the weights of SPAN of them.

    Args:
        position: float64, panel coordinates. by_u, by_v: change per sensor pixel along u and v.
        size: of the picture. count: of pixels shown.
    """
    camera, kind = reading.cameras + image * CAMERA_FIELDS, tl.load(subpixels.kind + i)
    period, cells = subpixels.period + 2 * kind + AXIS, subpixels.cells + 2 * kind + AXIS
    period, cells = tl.load(period), tl.load(cells)
    shape = (image * subpixels.kinds + kind) * 2 + AXIS
    width = tl.load(subpixels.width + shape)
    slant_variance = tl.load(subpixels.slant_variance + shape)
    place = (position - tl.load(subpixels.centre + 2 * i + AXIS)) * cells
    nearest = tl.floor(place + 0.5)
    offset = (place - nearest).to(tl.float32)
    box, sigma = footprint(by_u, by_v, period.to(tl.float32), slant_variance, camera)
    narrowed = narrowing(box, sigma, width, TAPS)
    shares = tap_shares(offset, box * narrowed, sigma * narrowed, width, TAPS)
    first = (nearest - TAPS // 2) * period + tl.load(subpixels.pixel + 2 * i + AXIS)
    if DARK:
        end = tl.load(camera + ALPHA) * size
        from_middle, half = (position - 0.5 * end) * cells, 0.5 * end * cells
        whole = share_between(from_middle.to(tl.float32), half.to(tl.float32), box, sigma)
        lit = ()
        for tap in tl.static_range(TAPS):
            pixel = first + tap * period
            alone = tl.where((pixel >= 0.0) & (pixel < end), 1.0, 0.0)
            lit = lit + (shares[tap] * tl.where(narrowed < 1.0, whole, alone),)
        shares = lit
    scale = tl.load(reading.shown_scale + image)
    start, weights = weights_on_shown(
        place_on_shown(first, scale, screen), (period * scale).to(tl.float32), shares, count,
        TAPS, SPAN,
    )  # fmt: skip
    return offset, start, weights


@triton.jit
def _modulation(x, y, by_u, by_v, i, image, reading, subpixels):
    """Return the light of subpixels i on a white picture, at offsets in cells from the nearest.

    by_u, by_v: change of both panel coordinates per sensor pixel along u and v.
    """
    camera, kind = reading.cameras + image * CAMERA_FIELDS, tl.load(subpixels.kind + i)
    cells_x = tl.load(subpixels.cells + 2 * kind).to(tl.float32)
    cells_y = tl.load(subpixels.cells + 2 * kind + 1).to(tl.float32)
    light = 0.0 * x + tl.load(subpixels.mean + image * subpixels.kinds + kind)
    last = tl.load(subpixels.first_term + kind + 1)
    for term in range(tl.load(subpixels.first_term + kind), last):
        k, l = tl.load(subpixels.k + term), tl.load(subpixels.l + term)
        amplitude = tl.load(subpixels.amplitude + image * subpixels.terms + term)
        fx, fy = k * cells_x, l * cells_y
        fu, fv = fx * by_u[0] + fy * by_u[1], fx * by_v[0] + fy * by_v[1]
        cosine, _ = wave(k * x + l * y)
        light += amplitude * transfer(fu, fv, camera) * cosine
    return light


@triton.jit
def see(
    i, sight, image, reading, screen, subpixels,
    COLUMNS: tl.constexpr, ROWS: tl.constexpr, TAPS: tl.constexpr, DARK: tl.constexpr,
):  # fmt: skip
    """Return what pixels see of subpixels i: their light on a white picture; the first column and
    row of the pixels shown that it comes from, and the weights of these columns and rows."""
    (x, y), by_u, by_v = sight
    offset_x, left, across = _along_axis(
        x, by_u[0], by_v[0], screen.width, screen.columns, i, image, reading, screen, subpixels,
        0, COLUMNS, TAPS, DARK,
    )  # fmt: skip
    offset_y, top, down = _along_axis(
        y, by_u[1], by_v[1], screen.height, screen.rows, i, image, reading, screen, subpixels,
        1, ROWS, TAPS, DARK,
    )  # fmt: skip
    white = _modulation(offset_x, offset_y, by_u, by_v, i, image, reading, subpixels)
    return white, left, top, across, down
