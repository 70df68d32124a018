"""Screen to raw by the panel's light at each sensor pixel's centre, as in the paper's code: the
exposure "point"."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl

from moireaug.engine.gpu.patch import Patch, place_on_shown, split_place
from moireaug.engine.gpu.view import ALPHA
from moireaug.engine.lower.exposure_records import Exposure, PointView

MIN_LIGHT = tl.constexpr(1e-12)  # that a weighted mean is divided by

BLOCK = 128  # pixels of a plane that one program computes, so that no compiler spills registers


class Subpixels(NamedTuple):
    """What the method reads of the subpixels of a panel's cell.

    Args:
        rectangle: (n, 4) float32, x0, y0, x1 and y1 in raster subpixels from the cell's corner.
        period: (n, 2) float64, of their cells, raster subpixels. cells: its inverse.
        lit: (B,) float32, share of each that emits.
        raster: raster subpixels along each side of a panel pixel.
    """

    rectangle: Any
    period: Any
    cells: Any
    lit: Any
    raster: int


def subpixels_of(e: Exposure, view: PointView) -> Subpixels:
    """Return an exposure's Subpixels, of arrays."""
    period = (e.cell.period[e.cell.kind] * view.raster).astype(np.float64)
    return Subpixels(view.rectangles * view.raster, period, 1 / period, view.lit, view.raster)


def span_of(_: Exposure) -> tuple[int, int]:
    """Return how many columns and rows of pixels shown a pixel sees of a subpixel."""
    return 2, 2


@triton.jit
def _covered(column, low, high, around):
    """Return the share of a raster column that lies between `low` and `high`, or in their copies
    `around` columns before and behind."""
    share = 0.0 * column
    for copy in tl.static_range(3):
        left = column + (copy - 1) * around
        share += tl.maximum(tl.minimum(left + 1.0, high) - tl.maximum(left, low), 0.0)
    return share


@triton.jit
def _along_axis(i, position, site, batch, AXIS: tl.constexpr, DARK_AROUND: tl.constexpr):
    """Return what pixels see of subpixel i along one axis, through the two nearest raster
    subpixels: its light, and the first of two pixels shown that it comes from, with their weights.

    position: float64, panel coordinates.
    """
    subpixels, screen = batch.subpixels, batch.screen
    edges = subpixels.rectangle + 4 * i + AXIS
    low, high, period = tl.load(edges), tl.load(edges + 2), tl.load(subpixels.period + 2 * i + AXIS)
    # half a raster subpixel off whole panel pixels: float32 has digits enough
    panel_pixels, place = 1.0 / subpixels.raster, position * subpixels.raster - 0.5
    before = tl.floor(place)
    to_second = (place - before).to(tl.float32)
    cell = tl.floor((before + 0.5) * tl.load(subpixels.cells + 2 * i + AXIS))
    column, period = (before - cell * period).to(tl.float32), period.to(tl.float32)
    next_column = tl.where(column + 1.0 < period, column + 1.0, 0.0)
    is_whole = high - low >= period
    first = (1.0 - to_second) * tl.where(is_whole, 1.0, _covered(column, low, high, period))
    second = to_second * tl.where(is_whole, 1.0, _covered(next_column, low, high, period))
    here = tl.floor((before + 0.5) * panel_pixels).to(tl.int32)
    there = tl.floor((before + 1.5) * panel_pixels).to(tl.int32)
    if DARK_AROUND:
        end = tl.load(site.camera + ALPHA) * screen.size[AXIS]
        first = tl.where((here >= 0) & (here + 0.5 < end), first, 0.0)
        second = tl.where((there >= 0) & (there + 0.5 < end), second, 0.0)
    light = first + second
    share = second / tl.maximum(light, MIN_LIGHT)
    panel_pixel = here + ((there - here) * share + 0.5).to(tl.float64)
    place = place_on_shown(panel_pixel, site.shown_scale, screen)
    pixel, to_next = split_place(place, screen.pixels[AXIS])
    return light, pixel, (1.0 - to_next, to_next)


@triton.jit
def see(i, sight, site, batch, variant: tl.constexpr):
    """Return what pixels see of subpixel i, as `spectral.see` does."""
    light_x, left, across = _along_axis(i, sight[0][0], site, batch, 0, variant.dark_around)
    light_y, top, down = _along_axis(i, sight[1][0], site, batch, 1, variant.dark_around)
    lit = tl.load(batch.subpixels.lit + site.image)
    return light_x * light_y * lit, Patch(left, top, across, down)
