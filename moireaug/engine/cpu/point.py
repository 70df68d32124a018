"""Screen to raw by the panel's light at each sensor pixel's centre, as in the paper's code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.camera.exposure.screen import EDGE_PIXELS
from moireaug.engine.cpu.compiling import copy, fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.panel import shrink
from moireaug.engine.cpu.sensor import attenuate, read, reflect
from moireaug.engine.cpu.vectors import load, store
from moireaug.engine.cpu.view import look

MIN_LIGHT = 1e-12  # that a weighted mean is divided by
ZERO = np.float32(0)
ONE32 = np.int32(1)


class _Axis(NamedTuple):
    """What is shown of a picture along one axis.

    Args:
        ratio: panel pixels per pixel shown. lead: pixels shown ahead of the picture; size: all of
            them. end: panel pixels that the picture takes.
        raster: raster subpixels per panel pixel. dark_around: see `exposure_records.Exposure`.
    """

    ratio: float
    lead: int
    size: int
    end: float
    raster: float
    dark_around: bool


class _AxisLight(NamedTuple):
    """What n pixels see of a subpixel along one axis.

    Args:
        light: (n,) float32, of the subpixel.
        pixel: (n,) int32, the pixel shown that it comes from. share: (n,) float32, how far from
            there towards the next one.
    """

    light: np.ndarray
    pixel: np.ndarray
    share: np.ndarray


@jit_inlined
def _empty_axis_light(n):
    """Return an _AxisLight of n pixels, without values."""
    return _AxisLight(np.empty(n, np.float32), np.empty(n, np.int32), np.empty(n, np.float32))


@jit_in_place
def shown_pixels(size, alpha):
    """Return how many pixels are shown of `size` picture pixels."""
    return math.ceil(alpha * size) + 2 * EDGE_PIXELS if alpha < 1 else size


@jit_in_place
def shown_values(height, width):
    """Return how many values of each colour are kept for so many pixels shown: a bilinear look-up's
    right or lower pixel may lie beyond the last, where its share is 0."""
    return (height + 1) * width + 1


@jit_in_place
def _axis(size, alpha, raster, dark_around):
    """Return the _Axis of `size` picture pixels, on a panel of at most its pixels, as in
    `exposure.screen.DisplayedPicture`."""
    if alpha < 1:
        return _Axis(1.0, EDGE_PIXELS, shown_pixels(size, alpha), alpha * size, raster, dark_around)
    return _Axis(alpha, 0, size, alpha * size, raster, dark_around)


@jit_in_place
def _covered_share(column, low, high, around):
    """Return the share of a raster column that lies between `low` and `high`, or in their copies
    `around` columns before and behind."""
    covered = max(min(column + 1, high) - max(column, low), 0.0)
    if low < 0:
        covered += max(min(column + 1 - around, high) - max(column - around, low), 0.0)
    if high > around:
        covered += max(min(column + 1 + around, high) - max(column + around, low), 0.0)
    return covered


@jit_in_place
def _raster(out, at, low, high, period, axis):
    """Fill an _AxisLight with what is seen at panel coordinates `at` of a rectangle from `low` to
    `high`, in panel pixels, interpolated between the two nearest raster subpixels.

    period: of the cell, panel pixels. axis: an _Axis.
    """
    light, first, share = out
    whole, n = high - low >= period, axis.raster
    ratio, lead, size = axis.ratio, axis.lead, axis.size
    end, dark_around = axis.end, axis.dark_around
    low, high, around = low * n, high * n, n * period
    for i in range(len(light)):
        place = load(at, i) * n - 0.5
        left = np.floor(place)
        second_light = place - left
        first_light = 1 - second_light
        if not whole:
            column = left - np.floor(left / around) * around
            first_light *= _covered_share(column, low, high, around)
            column = column + 1 if column + 1 < around else 0.0
            second_light *= _covered_share(column, low, high, around)
        here, there = np.floor((left + 0.5) / n) + 0.5, np.floor((left + 1.5) / n) + 0.5
        if dark_around:
            first_light *= 1.0 if (here >= 0) & (here < end) else 0.0
            second_light *= 1.0 if (there >= 0) & (there < end) else 0.0
        total = first_light + second_light
        x = (here + (there - here) * second_light / max(total, MIN_LIGHT)) / ratio + lead - 0.5
        x = min(max(x, 0.0), size - 1.0)
        pixel = np.int32(x)
        store(light, i, total)
        store(first, i, pixel)
        store(share, i, x - pixel)


@jit_in_place
def _add_content(out, shown, along_x, along_y, width, passed):
    """Add the content of a subpixel to out (n,).

    Args:
        shown: flat, rows of `width` pixels. along_x, along_y: _AxisLight.
        passed: float32, share of the subpixel's light that is read.
    """
    across, left, fx = along_x
    down, top, fy = along_y
    for i in range(len(out)):
        k = np.int32(np.int32(load(top, i) * width) + load(left, i))
        f = load(fx, i)
        a, b = load(shown, k), load(shown, np.int32(k + ONE32))
        k = np.int32(k + width)
        c, d = load(shown, k), load(shown, np.int32(k + ONE32))
        above, below = a + f * (b - a), c + f * (d - c)
        content = above + load(fy, i) * (below - above)
        store(out, i, out[i] + content * load(across, i) * load(down, i) * passed)


@jit_inlined
def fill_shown(shown, light, alpha):
    """Fill shown (3, `shown_values`) with a picture's light (3, H, W): rows one after another."""
    height, width = shown_pixels(light.shape[1], alpha), shown_pixels(light.shape[2], alpha)
    fill(shown.reshape(-1), ZERO)
    for c in range(3):
        if alpha < 1:
            panel = shown[c, : height * width].reshape(height, width)
            shrink(panel, light[c], alpha, 1, EDGE_PIXELS, EDGE_PIXELS)
        else:
            copy(shown[c], light[c].reshape(-1))


class _Work(NamedTuple):
    """What a row of readings is computed in.

    Args:
        columns, rows: an _Axis each. x, y, u, v: (w,) float64, where the pixels look and lie.
        along_x, along_y: what they see of a subpixel. light, noise, bits: (w,) float32 and int32.
    """

    columns: _Axis
    rows: _Axis
    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    along_x: _AxisLight
    along_y: _AxisLight
    light: np.ndarray
    noise: np.ndarray
    bits: np.ndarray


@jit_inlined
def work_of_points(w, image):
    """Return the _Work of a reading w wide."""
    (height, width), dark_around = image.points.size, image.points.dark_around
    raster, alpha = float(image.points.raster), image.camera.alpha
    return _Work(
        _axis(width, alpha, raster, dark_around),
        _axis(height, alpha, raster, dark_around),
        np.empty(w),
        np.empty(w),
        np.empty(w),
        np.empty(w),
        _empty_axis_light(w),
        _empty_axis_light(w),
        np.empty(w, np.float32),
        np.empty(w, np.float32),
        np.empty(w, np.int32),
    )


@jit_in_place
def locate_points(work, image, plane, v):
    """Fill where a plane's pixels on row v lie, and where they look."""
    sites = image.sites
    for i in range(len(work.u)):
        work.u[i] = sites.cols[sites.col[plane] + i * sites.step]
    fill(work.v, v)
    look(work.x, work.y, work.u, v, image.camera)


@jit_in_place
def see(work, image, i):
    """Fill what the pixels see of subpixel i."""
    x0, y0, x1, y1 = image.points.rectangles[i]
    px, py = image.cell.period[image.cell.subpixel_kind[i]]
    _raster(work.along_x, work.x, x0, x1, float(px), work.columns)
    _raster(work.along_y, work.y, y0, y1, float(py), work.rows)


@jit_in_place
def expose_rows(raw, slope, shown, image, work, top, bottom):
    """Do the same as `full.expose_rows` for a reading at points.

    shown: from `fill_shown`. work: from `work_of_points`.
    """
    planes, h, w = raw.shape
    camera, sites = image.camera, image.sites
    line, width, step = work.light, np.int32(work.columns.size), sites.step
    for r in range(top * step, bottom * step):
        pulse = image.flicker[r] if len(image.flicker) > 0 else 1.0
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            locate_points(work, image, plane, sites.rows[r])
            fill(line, ZERO)
            for i in range(len(image.points.rectangles)):
                colour = image.cell.channel[i]
                passed = image.filters[sites.channel[plane], colour] * pulse
                if passed == 0:
                    continue
                see(work, image, i)
                lit = np.float32(image.points.lit * passed)
                _add_content(line, shown[colour], work.along_x, work.along_y, width, lit)
            reflect(line, work.u, work.v, image.white[plane], camera)
            attenuate(line, work.u, work.v, camera)
            y = r // step
            start = (plane * h + y) * w
            read(raw[plane, y], line, slope[plane, y], start, image.readout, work.noise, work.bits)
