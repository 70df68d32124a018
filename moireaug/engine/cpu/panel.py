"""The picture as the panel shows it: resampled to panel pixels once, with a margin so that no
look-up leaves it."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.cpu.compiling import copy, fill, jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.physics import panel as triangle
from moireaug.engine.cpu.vectors import add, gather, load, store

ZERO = np.float32(0)
MARGIN_CELLS = 5  # beyond the cell's `radius`: half of the widest window, and one


@jit_in_place
def shape(size, camera, cell):
    """Return the height and width of the panel's picture with its margins, whole cells of every
    kind."""
    height = camera.alpha * size[0] + camera.lead_y
    width = camera.alpha * size[1] + camera.lead_x
    around, px, py = 2 * (cell.radius + MARGIN_CELLS), cell.common_period[0], cell.common_period[1]
    return (math.ceil(height / py) + around) * py, (math.ceil(width / px) + around) * px


@jit_in_place
def margin(cell, axis):
    """Return how many panel pixels of margin lie ahead of the picture."""
    return (cell.radius + MARGIN_CELLS) * cell.common_period[axis]


@jit_in_place
def period_of(cell, channel):
    """Return the period along x of a channel's subpixels, which share one."""
    for i in range(len(cell.channel)):
        if cell.channel[i] == channel:
            return cell.period[cell.subpixel_kind[i], 0]
    return 1


@jit_in_place
def _pixel_at(i, n, period):
    """Return the position of the panel pixel that is stored as number i of n: the first pixels of
    all cells of `period` pixels come first, then their second, and so on."""
    cells = n // period
    return i % cells * period + i // cells


@jit
def interpolated_pixels(n, size, alpha, period, lead):
    """Return the picture pixel before each of n panel pixels, of `size`, (n,) int32, and how far it
    is towards the next one, (n,) float32.

    period: see `_pixel_at`. lead: panel pixels ahead of the picture.
    """
    first, share = np.empty(n, np.int32), np.empty(n, np.float32)
    for i in range(n):
        at = triangle.centre_on_picture(_pixel_at(i, n, period), lead, alpha)
        at = min(max(at - 0.5, 0.0), size - 1.0)
        first[i] = np.int32(at)
        share[i] = at - first[i]
    return first, share


@jit_in_place
def _interpolate_rows(out, first, second, f):
    """Fill out (w + 1,) with a row interpolated between two (w,), its last pixel repeated."""
    w = len(first)
    for i in range(w):
        out[i] = first[i] + f * (second[i] - first[i])
    out[w] = out[w - 1]


@jit_in_place
def _interpolate_row(out, row, first, share):
    for i in range(len(out)):
        x = load(first, i)
        low = load(row, x)
        store(out, i, low + load(share, i) * (load(row, np.int32(x + np.int32(1))) - low))


@jit
def _enlarge(panel, light, alpha, period, ahead, above):
    """Fill panel (n, m), of one colour, from its light (h, w): bilinear between pixel centres."""
    (h, w), (n, m) = light.shape, panel.shape
    y, fy = interpolated_pixels(n, h, alpha, 1, above)
    x, fx = interpolated_pixels(m, w, alpha, period, ahead)
    row = np.empty(w + 1, np.float32)
    for i in range(n):
        low = np.int64(y[i])
        _interpolate_rows(row, light[low], light[min(low + 1, h - 1)], fy[i])
        _interpolate_row(panel[i], row, x, fx)


@jit
def averaged_pixels(n, size, alpha, period, lead):
    """Return which picture pixels each of n panel pixels shows, (taps, n) int32, and how much of
    each, (taps, n) float32; the rest as in `interpolated_pixels`."""
    taps = math.ceil(2 / alpha)  # picture pixels under a triangle
    pixel, weight = np.empty((taps, n), np.int32), np.empty((taps, n), np.float32)
    for i in range(n):
        at = triangle.centre_on_picture(_pixel_at(i, n, period), lead, alpha)
        first, total = triangle.first_under_triangle(at, alpha), 0.0
        for tap in range(taps):
            total += triangle.triangle_weight(first + tap, at, alpha)
        for tap in range(taps):
            share = triangle.triangle_weight(first + tap, at, alpha)
            weight[tap, i] = share / total
            pixel[tap, i] = min(max(first + tap, 0), size - 1)
    return pixel, weight


@jit
def shrink(panel, light, alpha, period, ahead, above):
    """Fill panel (n, m), of one colour and fewer pixels than the picture, from its light (h, w):
    each with the mean under a triangle that ends one panel pixel from its centre, along each axis.

    Args:
        period: see `_pixel_at`. ahead, above: panel pixels ahead of the picture.
    """
    (h, w), (n, m) = light.shape, panel.shape
    x, across = averaged_pixels(m, w, alpha, period, ahead)
    y, down = averaged_pixels(n, h, alpha, 1, above)
    row = np.empty(w, np.float32)
    for i in range(n):
        fill(row, ZERO)
        for tap in range(len(y)):
            if down[tap, i] != 0:
                add(row, light[y[tap, i]], down[tap, i])
        gather(panel[i], row, x, across)


@jit
def _on_picture(n, size, alpha, period, lead):
    """Return whether each of n panel pixels is on the picture, (n,) bool; the rest as in
    `interpolated_pixels`."""
    on_picture = np.empty(n, np.bool_)
    for i in range(n):
        at = triangle.centre_on_picture(_pixel_at(i, n, period), lead, alpha)
        on_picture[i] = 0 <= at < size
    return on_picture


@jit
def blacken(panel, size, alpha, period, ahead, above):
    """Blacken what lies beyond the picture, on one colour's panel (n, m)."""
    n, m = panel.shape
    x, y = _on_picture(m, size[1], alpha, period, ahead), _on_picture(n, size[0], alpha, 1, above)
    for i in range(n):
        for j in range(m):
            if not (y[i] and x[j]):
                panel[i, j] = 0


@jit
def _surround(panel, light, ahead, above):
    """Fill panel (n, m), of one colour, with its light (h, w) and margins around it."""
    h, w = light.shape
    for i in range(len(panel)):
        row, shown = light[min(max(i - above, 0), h - 1)], panel[i]
        fill(shown[:ahead], row[0])
        copy(shown[ahead : ahead + w], row)
        fill(shown[ahead + w :], row[w - 1])


@jit_inlined
def fill_panel(panel, light, camera, cell, dark_around):
    """Fill panel (3, h, w) float32, of `shape`, from the picture's light (3, H, W) float32.

    A row holds the first pixel of each of its colour's cells, then the second, and so on, so that
    look-ups read contiguous memory. Beyond the border the outermost pixel or, if `dark_around`,
    black.
    """
    ahead, above, alpha = margin(cell, 0), margin(cell, 1), camera.alpha
    for c in range(3):
        period = period_of(cell, c)
        if alpha < 1:
            lead_x, lead_y = ahead + camera.lead_x, above + camera.lead_y
            shrink(panel[c], light[c], alpha, period, lead_x, lead_y)
        elif alpha == 1 and period == 1:
            _surround(panel[c], light[c], ahead, above)
        else:
            _enlarge(panel[c], light[c], alpha, period, ahead, above)
        if dark_around:
            blacken(panel[c], light.shape[1:], alpha, period, ahead, above)
