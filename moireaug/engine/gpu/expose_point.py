"""Screen to raw by the panel's light at each sensor pixel's centre, as in the paper's code: the
exposure "point"."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import triton
import triton.language as tl
from torch import Tensor

from moireaug.engine.gpu import full_reading
from moireaug.engine.gpu.arrays import CAMERA_FIELDS
from moireaug.engine.gpu.full_reading import Method
from moireaug.engine.gpu.panel import place_on_shown, split
from moireaug.engine.gpu.view import ALPHA
from moireaug.engine.lower.exposure_records import Exposure

MIN_LIGHT = tl.constexpr(1e-12)  # that a weighted mean is divided by


class Subpixels(NamedTuple):
    """The subpixels of a panel's cell.

    Args:
        colour: (n,) int32. rectangle: (n, 4) float32, x0, y0, x1 and y1 in raster subpixels from
            the cell's corner. period: (n, 2) float64, of their cells, raster subpixels. cells: its
            inverse.
        lit: (B,) float32, share of each that emits.
        raster: (2,) float64, raster subpixels along each side of a panel pixel, and its inverse.
        length: n.
    """

    colour: Any
    rectangle: Any
    period: Any
    cells: Any
    lit: Any
    raster: Any
    length: int


def expose(picture: Tensor, exposure: Exposure) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    return full_reading.expose(picture, exposure, _method_of(exposure))


def expose_back(grad: Tensor, picture: Tensor, exposure: Exposure) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings."""
    return full_reading.expose_back(grad, picture, exposure, _method_of(exposure))


def _method_of(e: Exposure) -> Method:
    assert e.point is not None
    period = (e.cell.period[e.cell.kind] * e.point.raster).astype(np.float64)
    subpixels = Subpixels(
        colour=e.cell.channel.astype(np.int32),
        rectangle=(e.point.rectangles * e.point.raster).astype(np.float32),
        period=period,
        cells=1 / period,
        lit=e.point.lit.astype(np.float32),
        raster=np.array([e.point.raster, 1 / e.point.raster]),
        length=len(e.cell.channel),
    )
    return Method(see, subpixels, 2, 2)


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
def _along_axis(
    position, size, count, i, image, reading, screen, subpixels,
    AXIS: tl.constexpr, DARK: tl.constexpr,
):  # fmt: skip
    """Return what pixels see of subpixel i along one axis, through the two nearest raster
    subpixels: its light, and the first of two pixels shown that it comes from, with their weights.

    Args:
        position: float64, panel coordinates. size: of the picture. count: of pixels shown.
    """
    low, high = subpixels.rectangle + 4 * i + AXIS, subpixels.rectangle + 4 * i + 2 + AXIS
    low, high, period = tl.load(low), tl.load(high), tl.load(subpixels.period + 2 * i + AXIS)
    per_panel_pixel, panel_pixels = tl.load(subpixels.raster), tl.load(subpixels.raster + 1)
    place = position * per_panel_pixel - 0.5
    before = tl.floor(place)
    to_second = (place - before).to(tl.float32)
    cell = tl.floor((before + 0.5) * tl.load(subpixels.cells + 2 * i + AXIS))
    column, period = (before - cell * period).to(tl.float32), period.to(tl.float32)
    next_column = tl.where(column + 1.0 < period, column + 1.0, 0.0)
    is_whole = high - low >= period
    first = (1.0 - to_second) * tl.where(is_whole, 1.0, _covered(column, low, high, period))
    second = to_second * tl.where(is_whole, 1.0, _covered(next_column, low, high, period))
    here = tl.floor((before + 0.5) * panel_pixels) + 0.5
    there = tl.floor((before + 1.5) * panel_pixels) + 0.5
    if DARK:
        end = tl.load(reading.cameras + image * CAMERA_FIELDS + ALPHA) * size
        first = tl.where((here >= 0.0) & (here < end), first, 0.0)
        second = tl.where((there >= 0.0) & (there < end), second, 0.0)
    light = first + second
    panel_pixel = here + (there - here) * (second / tl.maximum(light, MIN_LIGHT))
    scale = tl.load(reading.shown_scale + image)
    pixel, to_next = split(place_on_shown(panel_pixel, scale, screen), count)
    return light, pixel, (1.0 - to_next, to_next)


@triton.jit
def see(
    i, sight, image, reading, screen, subpixels,
    COLUMNS: tl.constexpr, ROWS: tl.constexpr, TAPS: tl.constexpr, DARK: tl.constexpr,
):  # fmt: skip
    """Return what pixels see of subpixel i, as `expose_full.see` does."""
    (x, y), _, _ = sight
    light_x, left, across = _along_axis(
        x, screen.width, screen.columns, i, image, reading, screen, subpixels, 0, DARK
    )
    light_y, top, down = _along_axis(
        y, screen.height, screen.rows, i, image, reading, screen, subpixels, 1, DARK
    )
    return light_x * light_y * tl.load(subpixels.lit + image), left, top, across, down
