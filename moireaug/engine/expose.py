"""Screen to raw, one image per call: from the panel's light to the clipped reading, a sensor row at
a time."""

from __future__ import annotations

import math

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
BANDS = 224  # at least so many, if a photo has the rows; rows of a band share their weights


@inner
def _columns(u, column, share, cols, first, step, node_step, count, to_next):
    """Fill where each pixel of a row lies on the photo, and between which columns of nodes."""
    for i in range(len(u)):
        u[i] = cols[first + i * step]
        node, t = bracket(u[i], cols[0], node_step, count, 1)
        column[i], share[i] = node * to_next, t


@inner
def _sites(first, asked, sites, filters):
    """Fill first (planes,) with the first plane of each plane's site, and asked (planes, 3), in the
    rows of those planes, with the colours of light that any of the site's filters passes."""
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
def expose(  # noqa: C901  # one pass, row by row
    raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, seed, clips
):
    """Fill raw (planes, h, w) float32 with the reading of one image.

    Args:
        panel: (3, ...) float32, from `panel.show`.
        size: (height, width) of the panel in panel pixels, rounded up.
        camera, cell, nodes, sites: see `record`.
        filters, white: (3, 3) and (planes,) float64, see `record.Exposure`.
        flicker: (rows,) float64, each sensor row's light relative to the mean; empty without
            flicker.
        noise: whether there is any. seed: int64, of the noise.
        clips: whether the reading is clipped to [0, 1].
    """
    planes, h, w = raw.shape
    rows, cols, step = sites.rows, sites.cols, sites.step
    # the cells' weights, and where in them a row's pixels lie
    tables = nodes.tables
    kinds, _, count, _, phases, width = tables.shape
    to_next, of_y, phases = np.int32(2 * phases * width), np.int32(phases * width), phases - 2
    weights = np.empty((kinds, count * to_next), np.float32)
    u, share = np.empty((planes, w), np.float64), np.empty((planes, w), np.float32)
    column = np.empty((2, planes, w), np.int32)
    for plane in range(planes):
        _columns(
            u[plane],
            column[0, plane],
            share[plane],
            cols,
            sites.col[plane],
            step,
            nodes.step_uw,
            count,
            to_next,
        )
        for i in range(w):
            column[1, plane, i] = column[0, plane, i] + of_y
    first, asked = np.empty(planes, np.int64), np.empty((planes, 3), np.bool_)
    _sites(first, asked, sites, filters)
    noise_keys = keys(seed)
    terms, lines = nodes.terms, nodes.lines
    weight = np.empty(4, np.float32)
    # a row's buffers
    at = np.empty((2, w), np.float64)
    whole = np.empty((6, w), np.int32)
    line = np.empty((10, w), np.float32)
    x, y = at[0], at[1]
    nx, ny, base = whole[0], whole[1], whole[2]
    start_x, start_y, place = whole[3], whole[4], whole[5]
    dx, dy, past, content = line[0], line[1], line[2], line[3]
    through, light, numbers = line[4], line[5], line[6]
    glow, of_rows = line[7:], np.empty(w * width, np.float32)
    n_k, n_l = 1, 1
    for i in range(len(terms)):
        n_k, n_l = max(n_k, terms[i, harmonics.K] + 1), max(n_l, terms[i, harmonics.L] + 1)
    even, odd = np.empty((n_k, w), np.float32), np.empty((n_k, w), np.float32)
    here, beside = np.empty((n_k, w), np.float32), np.empty((n_k, w), np.float32)
    cx, sx = np.empty((n_k, w), np.float32), np.empty((n_k, w), np.float32)
    cy, sy = np.empty((n_l, w), np.float32), np.empty((n_l, w), np.float32)
    fill(cx[0], ONE)
    fill(sx[0], ZERO)
    fill(cy[0], ONE)
    fill(sy[0], ZERO)
    cos, sin = (
        np.empty((len(cell.channel), n_k), np.float32),
        np.empty((len(cell.channel), n_k), np.float32),
    )
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
                look(x, y, u[plane], v, camera)
                lookup.cells(dx, nx, x, 0.0, float(px), low, high_x)
                harmonics.waves(cx, sx, dx)
                fill(glow.reshape(-1), ZERO)
                held = -1
                for i in range(len(cell.channel)):
                    colour = cell.channel[i]
                    if not asked[plane, colour]:
                        continue
                    table, cells_x, cells_y = (
                        weights[cell.kind[i]],
                        column[0, plane],
                        column[1, plane],
                    )
                    if cell.row[i] != held:
                        held = cell.row[i]
                        lookup.cells(dy, ny, y, cell.centre[i, 1], float(py), low, high_y)
                        lookup.windows(start_y, place, past, dy, ny, cells_y, phases, width)
                        lookup.down(of_rows, table, to_next, place, past, share[plane], width)
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
                        share[plane], of_rows, width,
                    )  # fmt: skip
                    harmonics.shine(glow[colour], content, here, beside, cos[i], sin[i], through)
            fill(light, ZERO)
            for colour in range(3):
                add(light, glow[colour], np.float32(filters[sites.channel[plane], colour]))
            reflect(light, u[plane], v, white[plane], camera)
            attenuate(light, gain, u[plane], v, camera)
            start = (plane * h + row) * w
            read(raw[plane, row], light, camera, start, noise, noise_keys, numbers, clips)
