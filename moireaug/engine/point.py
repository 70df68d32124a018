"""Screen to raw by the panel's light at each sensor pixel's centre, as in the paper's code: one
image per call."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import copy, fill, inner, loop
from moireaug.engine.panel import shrink
from moireaug.engine.random_numbers import keys
from moireaug.engine.sensor import attenuate, read, reflect
from moireaug.engine.vectors import peek, poke
from moireaug.engine.view import look

AHEAD = 2  # panel pixels ahead of a picture, and behind it, until all is its edge pixels
LEAST = 1e-12
ZERO = np.float32(0)
ONE32 = np.int32(1)


@inner
def _lies_in(column, low, high, around):
    """Return the share of a raster column that lies between `low` and `high`, or in their copies
    `around` columns before and behind."""
    share = max(min(column + 1, high) - max(column, low), 0.0)
    if low < 0:
        share += max(min(column + 1 - around, high) - max(column - around, low), 0.0)
    if high > around:
        share += max(min(column + 1 + around, high) - max(column + around, low), 0.0)
    return share


@inner
def _raster(light, first, share, at, low, high, n, period, axis, dark):
    """Along one axis, find the light at panel coordinates `at` that comes from a rectangle, `low`
    to `high` in panel pixels, interpolated between the two nearest of n raster subpixels per panel
    pixel; and where on what is shown it comes from.

    axis: from `_axis`.
    """
    whole, (ratio, ahead, size, end) = high - low >= period, axis
    low, high, around = low * n, high * n, n * period
    for i in range(len(light)):
        place = peek(at, i) * n - 0.5
        left = np.floor(place)
        second = place - left
        first_light = 1 - second
        if not whole:
            column = left - np.floor(left / around) * around
            first_light *= _lies_in(column, low, high, around)
            column = column + 1 if column + 1 < around else 0.0
            second *= _lies_in(column, low, high, around)
        here, there = np.floor((left + 0.5) / n) + 0.5, np.floor((left + 1.5) / n) + 0.5
        if dark:
            first_light *= 1.0 if (here >= 0) & (here < end) else 0.0
            second *= 1.0 if (there >= 0) & (there < end) else 0.0
        total = first_light + second
        x = (here + (there - here) * second / max(total, LEAST)) / ratio + ahead - 0.5
        x = min(max(x, 0.0), size - 1.0)
        pixel = np.int32(x)
        poke(light, i, total)
        poke(first, i, pixel)
        poke(share, i, x - pixel)


@inner
def _add_content(out, picture, left, fx, across, top, fy, down, width, lit):
    for i in range(len(out)):
        k = np.int32(np.int32(peek(top, i) * width) + peek(left, i))
        f = peek(fx, i)
        a, b = peek(picture, k), peek(picture, np.int32(k + ONE32))
        k = np.int32(k + width)
        c, d = peek(picture, k), peek(picture, np.int32(k + ONE32))
        above, below = a + f * (b - a), c + f * (d - c)
        content = above + peek(fy, i) * (below - above)
        poke(out, i, out[i] + content * peek(across, i) * peek(down, i) * lit)


@inner
def _axis(size, alpha):
    """Return what is shown of a picture along an axis: panel pixels per pixel shown, those shown
    ahead of the picture, all of them, and how many panel pixels the picture takes.

    As `exposure.shown.Shown`, on a panel of at most the picture's pixels.
    """
    if alpha < 1:
        return 1.0, AHEAD, math.ceil(alpha * size) + 2 * AHEAD, alpha * size
    return alpha, 0, size, alpha * size


@loop
def expose_point(
    raw, light, camera, filters, white, cell, point, lit, sites, flicker, noise, seed, clips, dark
):
    """Fill raw (planes, h, w) float32 with the reading of a picture whose light (3, H, W) is
    float32.

    Args:
        point: see `exposure_records.Point`. lit: share of each subpixel that emits.
        filters, white, dark: see `exposure_records.Exposure`. The rest as in `expose.expose`.
    """
    planes, h, w = raw.shape
    rows, columns = _axis(light.shape[1], camera.alpha), _axis(light.shape[2], camera.alpha)
    height, width = rows[2], columns[2]
    # a bilinear look-up's right or lower pixel may lie beyond the last, where its share is 0
    shown = np.zeros((3, height * width + width + 1), np.float32)
    for c in range(3):
        if camera.alpha < 1:
            panel = shown[c, : height * width].reshape(height, width)
            shrink(panel, light[c], camera.alpha, 1, AHEAD, AHEAD)
        else:
            copy(shown[c], light[c].reshape(-1))
    x, y, u = np.empty(w), np.empty(w), np.empty(w)
    left, top = np.empty(w, np.int32), np.empty(w, np.int32)
    fx, fy = np.empty(w, np.float32), np.empty(w, np.float32)
    across, down = np.empty(w, np.float32), np.empty(w, np.float32)
    line, numbers = np.empty(w, np.float32), np.empty(w, np.float32)
    bits = np.empty(w, np.int32)
    noise_keys = keys(seed)
    step = sites.step
    vs = np.empty(w, np.float64)
    for r in range(h * step):
        v = sites.rows[r]
        fill(vs, v)
        pulse = flicker[r] if len(flicker) > 0 else 1.0
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            for i in range(w):
                u[i] = sites.cols[sites.col[plane] + i * step]
            look(x, y, u, v, camera)
            fill(line, ZERO)
            channel, n = sites.channel[plane], float(point.raster)
            for i in range(len(point.rectangles)):
                passed = filters[channel, cell.channel[i]] * pulse
                if passed == 0:
                    continue
                x0, y0, x1, y1 = point.rectangles[i]
                px, py = cell.period[cell.kind[i]]
                _raster(across, left, fx, x, x0, x1, n, float(px), columns, dark)
                _raster(down, top, fy, y, y0, y1, n, float(py), rows, dark)
                _add_content(
                    line,
                    shown[cell.channel[i]],
                    left,
                    fx,
                    across,
                    top,
                    fy,
                    down,
                    np.int32(width),
                    np.float32(lit * passed),
                )
            reflect(line, u, vs, white[plane], camera)
            attenuate(line, u, vs, camera)
            row = r // step
            read(
                raw[plane, row],
                line,
                camera,
                (plane * h + row) * w,
                noise,
                noise_keys,
                numbers,
                bits,
                clips,
            )
