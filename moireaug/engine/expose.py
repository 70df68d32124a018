"""Screen to raw, one image per call: from the panel's light to the clipped reading, a sensor row at
a time."""

from __future__ import annotations

import numpy as np

from moireaug.engine import harmonics, lookup
from moireaug.engine.compiling import fill, inner, part
from moireaug.engine.nodes import bracket
from moireaug.engine.panel import margin
from moireaug.engine.random_numbers import keys
from moireaug.engine.rows import places_of, row_of
from moireaug.engine.sensor import attenuate, read, reflect
from moireaug.engine.vectors import add
from moireaug.engine.view import look
from moireaug.engine.weights import blend, sizes

ZERO, ONE = np.float32(0), np.float32(1)
BANDS = 224  # at least so many, if a photo has the rows; rows of a band share their weights


@inner
def _weights(out, nodes, v, first):
    """Fill out (kinds, n) with the weights of cells on a row v."""
    kinds, rows = nodes.tables.shape[:2]
    node, t = bracket(v, first, nodes.step_vw, rows, 1)
    for kind in range(kinds):
        n = nodes.columns * sizes(nodes.phases[kind], nodes.cells[kind])[1]
        low, high = nodes.tables[kind, node, :n], nodes.tables[kind, node + 1, :n]
        blend(out[kind, :n], low, high, np.float32(t))


@inner
def _cells(size, period):
    """Return how many cells hold `size` panel pixels."""
    return (size + period - 1) // period


@inner
def _light(row, panel, size, camera, filters, cell, nodes, sites, places, plane, v):
    """Fill the row's glow with the light that a plane's pixels see on row v, in each colour that is
    asked for."""
    x, y, whole, line = row.at[0], row.at[1], row.whole, row.line
    nx, ny, base = whole[0], whole[1], whole[2]
    start_x, start_y, place = whole[3], whole[4], whole[5]
    dx, dy, past, through, content = line[0], line[1], line[2], line[3], line[4]
    even, odd, here, beside = row.wave[0], row.wave[1], row.wave[2], row.wave[3]
    cx, sx, cy, sy = row.wave[4], row.wave[5], row.of_y[0], row.of_y[1]
    share, of_rows, taps = places.share[plane], row.of_rows, cell.radius
    # the panel's pixels
    stride = panel.shape[2]
    pixels, low = panel.reshape(3, panel.shape[1] * stride), -taps - 1.0
    node, t = bracket(v, sites.rows[0], nodes.step_v, nodes.lines.shape[1], 3)
    harmonics.lagrange(row.weight, t)
    look(x, y, places.u[plane], v, camera)
    fill(row.glow.reshape(-1), ZERO)
    held_row, held_height, held_x = -1, -1, -1
    for i in range(len(cell.channel)):
        colour, kind = cell.channel[i], cell.kind[i]
        if not places.asked[plane, colour]:
            continue
        px, py = cell.period[kind, 0], cell.period[kind, 1]
        high_x, high_y = float(_cells(size[1], px) + taps), float(_cells(size[0], py) + taps)
        table, n_k = row.weights[kind], row.orders[kind]
        phases, cells, begin = nodes.phases[kind], nodes.cells[kind], places.column[kind]
        to_next = np.int32(sizes(phases, cells)[1])
        down, of_cell = np.int32(py * stride), stride // px
        if px != held_x:
            held_x = px
            lookup.cells(dx, nx, x, 0.0, float(px), low, high_x)
            harmonics.waves(cx, sx, dx)
        if cell.height[i] != held_height:
            held_height = cell.height[i]
            lookup.cells(dy, ny, y, cell.centre[i, 1], float(py), low, high_y)
            harmonics.waves(cy, sy, dy)
        if cell.row[i] != held_row:
            held_row = cell.row[i]
            lookup.windows(start_y, place, past, dy, ny, begin[1, plane], phases[1], cells)
            lookup.down(of_rows, table, to_next, place, past, share, cells)
            four = nodes.lines[sites.col[plane], node : node + 4]
            harmonics.across(even[:n_k], odd[:n_k], nodes.terms, kind, four, row.weight, cy, sy)
            harmonics.turn(here[:n_k], beside[:n_k], even, odd, cx, sx)
        lookup.cells(dx, nx, x, cell.centre[i, 0], float(px), low, high_x)
        lookup.windows(start_x, place, past, dx, nx, begin[0, plane], phases[0], cells)
        origin = (margin(cell, 1) + cell.pixel[i, 1]) * stride + margin(cell, 0) // px
        origin += cell.pixel[i, 0] * of_cell
        lookup.base_of(base, start_x, start_y, down, np.int32(origin))
        lookup.content(
            content, pixels[colour], base, down, table, to_next, place, past, share, of_rows,
            cells, taps,
        )  # fmt: skip
        harmonics.shine(
            row.glow[colour], content, here[:n_k], beside[:n_k], row.cos[i], row.sin[i], through
        )


@inner
def _expose(
    raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, noise_keys,
    clips, places, row, top, bottom,
):  # fmt: skip
    """Do the same as `expose`, in buffers that it allocated."""
    planes, h, w = raw.shape
    rows, step = sites.rows, sites.step
    light, numbers = row.line[5], row.line[6]
    band = max(1, len(rows) // BANDS)
    for r in range(top * step, bottom * step):
        v = rows[r]
        if r % band == 0 or r == top * step:
            start = r - r % band
            end = min(start + band, len(rows)) - 1
            middle = (rows[start] + rows[end]) / 2
            _weights(row.weights, nodes, middle, rows[0])
        gain = np.float32(camera.gain * (flicker[r] if len(flicker) > 0 else 1.0))
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            if places.first[plane] == plane:
                _light(row, panel, size, camera, filters, cell, nodes, sites, places, plane, v)
            fill(light, ZERO)
            for colour in range(3):
                add(light, row.glow[colour], np.float32(filters[sites.channel[plane], colour]))
            u = places.u[plane]
            reflect(light, u, v, white[plane], camera)
            attenuate(light, gain, u, v, camera)
            start = (plane * h + r // step) * w
            out = raw[plane, r // step]
            read(out, light, camera, start, noise, noise_keys, numbers, clips)


@part
def expose(
    raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, seed, clips, top,
    bottom,
):  # fmt: skip
    """Fill rows `top` to `bottom` of raw (planes, h, w) float32 with the reading of one image.

    Args:
        panel: (3, ...) float32, from `panel.show`.
        size: (height, width) of the panel in panel pixels, rounded up.
        camera, cell, nodes, sites: see `exposure_records`.
        filters, white: (3, 3) and (planes,) float64, see `exposure_records.Exposure`.
        flicker: (rows,) float64, each sensor row's light relative to the mean; empty without
            flicker.
        noise: whether there is any. seed: int64, of the noise.
        clips: whether the reading is clipped to [0, 1].
    """
    planes, _, w = raw.shape
    places, row = places_of(w, planes, sites, nodes, filters), row_of(w, cell, nodes)
    _expose(
        raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, keys(seed),
        clips, places, row, top, bottom,
    )  # fmt: skip
