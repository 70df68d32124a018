"""Screen to raw, one image per call: from the panel's light to the clipped reading, a sensor row at
a time."""

from __future__ import annotations

import numpy as np

from moireaug.engine.compiling import fill, inner, once, part
from moireaug.engine.glow import glow
from moireaug.engine.nodes import bracket
from moireaug.engine.random_numbers import keys
from moireaug.engine.rows import BITS, LIGHT, NUMBERS, V, places_of, row_of
from moireaug.engine.sensor import attenuate, read, reflect
from moireaug.engine.shares import sizes
from moireaug.engine.vectors import add
from moireaug.engine.weights import blend

ZERO = np.float32(0)
BANDS = 224  # at least so many, if a photo has the rows; rows of a band share their weights


@inner
def cell_weights(out, nodes, v, first):
    """Fill out (kinds, n) with the weights of cells on a row v."""
    kinds, rows = nodes.tables.shape[:2]
    node, t = bracket(v, first, nodes.step_vw, rows, 1)
    for kind in range(kinds):
        n = nodes.columns * sizes(nodes.phases[kind], nodes.cells[kind])[1]
        low, high = nodes.tables[kind, node, :n], nodes.tables[kind, node + 1, :n]
        blend(out[kind, :n], low, high, np.float32(t))


@once
def _expose(
    raw, panel, size, camera, filters, white, cell, nodes, sites, flicker, noise, noise_keys,
    clips, places, row, top, bottom,
):  # fmt: skip
    """Do the same as `expose`, in buffers that it allocated."""
    planes, h, w = raw.shape
    rows, step = sites.rows, sites.step
    light, numbers, bits = row.line[LIGHT], row.line[NUMBERS], row.whole[BITS]
    band = max(1, len(rows) // BANDS)
    for r in range(top * step, bottom * step):
        v = rows[r]
        if r % band == 0 or r == top * step:
            start = r - r % band
            end = min(start + band, len(rows)) - 1
            middle = (rows[start] + rows[end]) / 2
            cell_weights(row.weights, nodes, middle, rows[0])
        fill(row.at[V], v)
        pulse = flicker[r] if len(flicker) > 0 else 1.0
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            if places.first[plane] == plane:
                glow(row, panel, size, camera, cell, nodes, sites, places, plane, v)
            fill(light, ZERO)
            for colour in range(3):
                passed = filters[sites.channel[plane], colour] * pulse
                add(light, row.glow[colour], np.float32(passed))
            u = places.u[plane]
            reflect(light, u, row.at[V], white[plane], camera)
            attenuate(light, u, row.at[V], camera)
            start = (plane * h + r // step) * w
            out = raw[plane, r // step]
            read(out, light, camera, start, noise, noise_keys, numbers, bits, clips)


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
