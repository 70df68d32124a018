"""Screen to raw, one image a call: from the panel's light to the clipped reading, a sensor row at a
time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.engine import harmonics, lookup, optics
from moireaug.engine.compiling import fill, inner, loop
from moireaug.engine.nodes import bracket
from moireaug.engine.panel import margin
from moireaug.engine.random_numbers import keys
from moireaug.engine.sensor import attenuate, read, reflect
from moireaug.engine.vectors import add
from moireaug.engine.view import look

ZERO, ONE = np.float32(0), np.float32(1)
BANDS = 224  # of rows, if a photo has so many, whose weights are the same


class _Buffers(NamedTuple):
    """What an image's exposure works on.

    Args:
        weights: (kinds, n) float32, of cells on a row, with `to_next` from one node to the next.
        u: (planes, w) float64, photo coordinates of a plane's columns. column: (2, planes, w)
            int32, where their weights along x and y begin. share: (planes, w) float32, how far
            they are to the next node.
        first, asked: see `_sites`. shifts: (2, n, K + 1) float32, see `_shifts`.
        at: (2, w) float64, whole: (6, w) int32, line: (10, w) float32, of_rows: (w * width,)
            float32, along: (6, K + 1, w) float32, down: (2, L + 1, w) float32, a row's.
        weight: (4,) float32, of the cubic through four rows of nodes.
    """

    weights: np.ndarray
    to_next: np.int32
    u: np.ndarray
    column: np.ndarray
    share: np.ndarray
    first: np.ndarray
    asked: np.ndarray
    shifts: np.ndarray
    at: np.ndarray
    whole: np.ndarray
    line: np.ndarray
    of_rows: np.ndarray
    along: np.ndarray
    down: np.ndarray
    weight: np.ndarray


@inner
def _columns(u, column, share, cols, first, step, node_step, count, to_next):
    """Fill where each pixel of a row lies on the photo, and between which columns of nodes."""
    for i in range(len(u)):
        u[i] = cols[first + i * step]
        node, t = bracket(u[i], cols[0], node_step, count, 1)
        column[i], share[i] = node * to_next, t


@inner
def _sites(first, asked, sites, filters):
    """Fill for each plane the first plane (planes,) of the same site, and for that the colours of
    light (planes, 3) that any of the site's filters passes."""
    for plane in range(len(first)):
        first[plane] = plane
        if plane > 0:
            before = first[plane - 1]
            if sites.row[plane] == sites.row[before] and sites.col[plane] == sites.col[before]:
                first[plane] = before
        for colour in range(3):
            asked[plane, colour] = False
            if filters[sites.channel[plane], colour] != 0:
                asked[first[plane], colour] = True


@inner
def _shifts(cos, sin, cell):
    """Fill cos and sin (n, K + 1) with those of 2 pi k x at each subpixel's centre x."""
    for i in range(len(cos)):
        for k in range(cos.shape[1]):
            angle = 2 * math.pi * k * cell.centre[i, 0] / cell.period[0]
            cos[i, k], sin[i, k] = math.cos(angle), math.sin(angle)


@inner
def _weights(out, tables, v, first, step_v):
    """Fill out (kinds, n) with the weights of cells on a row v."""
    kinds, rows = tables.shape[:2]
    node, t = bracket(v, first, step_v, rows, 1)
    for kind in range(kinds):
        flat = tables[kind].reshape(rows, out.shape[1])
        optics.blend(out[kind], flat[node], flat[node + 1], np.float32(t))


@loop
def expose(
    raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, seed, clips
):
    """Fill raw (planes, h, w) float32 with the reading of one image.

    Args:
        panel: (3, ...) float32, from `panel.show`.
        size: (height, width) of the panel in panel pixels, rounded up.
        camera, cell, nodes, sites: see `record`.
        filters, white: (3, 3) and (planes,) float64, see `record.Exposure`.
        flicker: (rows,) float64, what each sensor row gets of the mean light; empty without
            flicker.
        noise: whether there is any. seed: int64, of it.
        clips: whether the reading ends at 0 and 1.
    """
    planes, _, w = raw.shape
    kinds, _, count, _, phases, width = nodes.tables.shape
    to_next = np.int32(2 * phases * width)
    n_k, n_l = 1, 1
    for i in range(len(nodes.terms)):
        n_k = max(n_k, nodes.terms[i, harmonics.K] + 1)
        n_l = max(n_l, nodes.terms[i, harmonics.L] + 1)
    buffers = _Buffers(
        np.empty((kinds, count * to_next), np.float32),
        to_next,
        np.empty((planes, w), np.float64),
        np.empty((2, planes, w), np.int32),
        np.empty((planes, w), np.float32),
        np.empty(planes, np.int64),
        np.empty((planes, 3), np.bool_),
        np.empty((2, len(cell.channel), n_k), np.float32),
        np.empty((2, w), np.float64),
        np.empty((6, w), np.int32),
        np.empty((10, w), np.float32),
        np.empty(w * width, np.float32),
        np.empty((6, n_k, w), np.float32),
        np.empty((2, n_l, w), np.float32),
        np.empty(4, np.float32),
    )
    _expose(
        raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, seed, clips,
        buffers,
    )  # fmt: skip


@inner
def _expose(  # noqa: C901  # one pass, row by row
    raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, seed, clips, b
):
    """Do as `expose`, in _Buffers b."""
    planes, h, w = raw.shape
    rows, step = sites.rows, sites.step
    # the cells' weights, and where in them a row's pixels lie
    tables, weights, u, share, to_next = nodes.tables, b.weights, b.u, b.share, b.to_next
    _, _, count, _, phases, width = tables.shape
    of_y, phases = np.int32(phases * width), phases - 2
    for plane in range(planes):
        cells_x, cells_y = b.column[0, plane], b.column[1, plane]
        _columns(
            u[plane],
            cells_x,
            share[plane],
            sites.cols,
            sites.col[plane],
            step,
            nodes.step_uw,
            count,
            to_next,
        )
        for i in range(w):
            cells_y[i] = cells_x[i] + of_y
    first, asked = b.first, b.asked
    _sites(first, asked, sites, filters)
    noise_keys = keys(seed)
    terms, lines, weight = nodes.terms, nodes.lines, b.weight
    x, y = b.at[0], b.at[1]
    nx, ny, base = b.whole[0], b.whole[1], b.whole[2]
    start_x, start_y, place = b.whole[3], b.whole[4], b.whole[5]
    dx, dy, past, content = b.line[0], b.line[1], b.line[2], b.line[3]
    through, light, numbers, glow = b.line[4], b.line[5], b.line[6], b.line[7:]
    even, odd, here, beside = b.along[0], b.along[1], b.along[2], b.along[3]
    cx, sx, cy, sy = b.along[4], b.along[5], b.down[0], b.down[1]
    fill(cx[0], ONE)
    fill(sx[0], ZERO)
    fill(cy[0], ONE)
    fill(sy[0], ZERO)
    cos, sin = b.shifts[0], b.shifts[1]
    _shifts(cos, sin, cell)
    # the panel's pixels
    px, py, stride = cell.period[0], cell.period[1], panel.shape[2]
    pixels, of_cell = panel.reshape(3, panel.shape[1] * stride), stride // px
    down, lead = np.int32(py * stride), margin(cell.taps)
    low, high_x = -cell.taps - 1.0, float((size[1] + px - 1) // px + cell.taps)
    high_y = float((size[0] + py - 1) // py + cell.taps)
    band = max(1, len(rows) // BANDS)
    for r in range(h * step):
        v, row = rows[r], r // step
        if r % band == 0:
            end = min(r + band, len(rows)) - 1
            _weights(weights, tables, (v + rows[end]) / 2, rows[0], nodes.step_vw)
        node, t = bracket(v, rows[0], nodes.step_v, lines.shape[1], 3)
        harmonics.lagrange(weight, t)
        gain = np.float32(camera.gain * (flicker[r] if len(flicker) > 0 else 1.0))
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            if first[plane] == plane:
                cells_x, cells_y = b.column[0, plane], b.column[1, plane]
                look(x, y, u[plane], v, camera)
                lookup.cells(dx, nx, x, 0.0, float(px), low, high_x)
                harmonics.waves(cx, sx, dx)
                fill(glow.reshape(-1), ZERO)
                held = -1
                for i in range(len(cell.channel)):
                    colour = cell.channel[i]
                    if not asked[plane, colour]:
                        continue
                    table = weights[cell.kind[i]]
                    if cell.row[i] != held:
                        held = cell.row[i]
                        lookup.cells(dy, ny, y, cell.centre[i, 1], float(py), low, high_y)
                        lookup.windows(start_y, place, past, dy, ny, cells_y, phases, width)
                        lookup.down(b.of_rows, table, to_next, place, past, share[plane], width)
                        harmonics.waves(cy, sy, dy)
                        four = lines[sites.col[plane], node : node + 4]
                        harmonics.across(even, odd, terms, cell.kind[i], four, weight, cy, sy)
                        harmonics.turn(here, beside, even, odd, cx, sx)
                    lookup.cells(dx, nx, x, cell.centre[i, 0], float(px), low, high_x)
                    lookup.windows(start_x, place, past, dx, nx, cells_x, phases, width)
                    origin = (lead * py + cell.pixel[i, 1]) * stride + cell.pixel[i, 0] * of_cell
                    lookup.base_of(base, start_x, start_y, down, np.int32(origin + lead))
                    lookup.content(
                        content, pixels[colour], base, down, table, to_next, place, past,
                        share[plane], b.of_rows, width,
                    )  # fmt: skip
                    harmonics.shine(glow[colour], content, here, beside, cos[i], sin[i], through)
            fill(light, ZERO)
            for colour in range(3):
                add(light, glow[colour], np.float32(filters[sites.channel[plane], colour]))
            reflect(light, u[plane], v, white[plane], camera)
            attenuate(light, gain, u[plane], v, camera)
            start = (plane * h + row) * w
            read(raw[plane, row], light, camera, start, noise, noise_keys, numbers, clips)
