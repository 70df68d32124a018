"""Screen to raw, one image a call: from the panel's light to the clipped reading, a sensor row at a
time."""

from __future__ import annotations

import numpy as np

from moireaug.engine import harmonics, lookup, optics
from moireaug.engine.compiling import fill, loop
from moireaug.engine.nodes import bracket
from moireaug.engine.panel import margin
from moireaug.engine.random_numbers import keys
from moireaug.engine.sensor import attenuate, read, reflect
from moireaug.engine.view import look

ZERO, ONE = np.float32(0), np.float32(1)
BANDS = 224  # of rows, if a photo has so many, whose weights are the same


@loop
def _columns(u, column, share, cols, first, step, node_step, count, to_next):
    """Fill where each pixel of a row lies on the photo, and between which columns of nodes."""
    for i in range(len(u)):
        u[i] = cols[first + i * step]
        node, t = bracket(u[i], cols[0], node_step, count, 1)
        column[i], share[i] = node * to_next, t


@loop
def _amplitudes(out, lines, v, first, step_v, weight):
    """Fill out (columns, T * w) with the terms' amplitudes on a row v."""
    node, t = bracket(v, first, step_v, lines.shape[1], 3)
    harmonics.lagrange(weight, t)
    for column in range(len(lines)):
        harmonics.between(out[column], lines[column], node, weight)


@loop
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
        flicker: (rows,) float64, what each sensor row gets of the mean light; empty without
            flicker.
        noise: whether there is any. seed: int64, of it.
        clips: whether the reading ends at 0 and 1.
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
    # the terms' amplitudes at a band's first row and behind its last
    terms = nodes.terms
    noise_keys = keys(seed)
    before = np.empty((step, len(terms) * w), np.float32)
    after = np.empty((step, len(terms) * w), np.float32)
    weight = np.empty(4, np.float64)
    # a row's buffers
    at = np.empty((2, w), np.float64)
    whole = np.empty((7, w), np.int32)
    line = np.empty((9, w), np.float32)
    x, y = at[0], at[1]
    nx, ny, base = whole[0], whole[1], whole[2]
    start_x, start_y, place_x, place_y = whole[3], whole[4], whole[5], whole[6]
    dx, dy, past_x, past_y = line[0], line[1], line[2], line[3]
    content, through, light, inner, numbers = line[4], line[5], line[6], line[7], line[8]
    n_k, n_l = 1, 1
    for i in range(len(terms)):
        n_k, n_l = max(n_k, terms[i, harmonics.K] + 1), max(n_l, terms[i, harmonics.L] + 1)
    cx, sx = np.empty((n_k, w), np.float32), np.empty((n_k, w), np.float32)
    cy, sy = np.empty((n_l, w), np.float32), np.empty((n_l, w), np.float32)
    fill(cx[0], ONE)
    fill(sx[0], ZERO)
    fill(cy[0], ONE)
    fill(sy[0], ZERO)
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
            end = min(r + band, len(rows) - 1)
            if r == 0:
                _amplitudes(after, nodes.lines, v, rows[0], nodes.step_v, weight)
            before, after = after, before
            _amplitudes(after, nodes.lines, rows[end], rows[0], nodes.step_v, weight)
            _weights(weights, tables, (v + rows[max(end - 1, r)]) / 2, rows[0], nodes.step_vw)
        t = np.float32((r % band) / max(end - r + r % band, 1))
        gain = np.float32(camera.gain * (flicker[r] if len(flicker) > 0 else 1.0))
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            channel = sites.channel[plane]
            early = before[sites.col[plane]].reshape(len(terms), w)
            late = after[sites.col[plane]].reshape(len(terms), w)
            look(x, y, u[plane], v, camera)
            fill(light, ZERO)
            for i in range(len(cell.channel)):
                passed = np.float32(filters[channel, cell.channel[i]])
                if passed == 0:
                    continue
                kind = cell.kind[i]
                lookup.cells(dx, nx, x, cell.centre[i, 0], float(px), low, high_x)
                lookup.cells(dy, ny, y, cell.centre[i, 1], float(py), low, high_y)
                lookup.windows(start_x, place_x, past_x, dx, nx, column[0, plane], phases, width)
                lookup.windows(start_y, place_y, past_y, dy, ny, column[1, plane], phases, width)
                origin = (lead * py + cell.pixel[i, 1]) * stride + cell.pixel[i, 0] * of_cell + lead
                lookup.base_of(base, start_x, start_y, down, np.int32(origin))
                lookup.content(
                    content, pixels[cell.channel[i]], base, down, weights[kind], to_next,
                    place_x, past_x, place_y, past_y, share[plane], width,
                )  # fmt: skip
                harmonics.waves(cx, sx, dx, n_l > 1)
                harmonics.waves(cy, sy, dy, True)
                harmonics.transmit(through, terms, kind, early, late, t, cx, sx, cy, sy, inner)
                harmonics.add_product(light, content, through, passed)
            reflect(light, u[plane], v, white[plane], camera)
            attenuate(light, gain, u[plane], v, camera)
            read(
                raw[plane, row],
                light,
                camera,
                (plane * h + row) * w,
                noise,
                noise_keys,
                numbers,
                clips,
            )
