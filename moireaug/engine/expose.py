"""Screen to raw, one image a call: from the panel's light to the clipped reading, a sensor row at a time."""

from __future__ import annotations

import numpy as np

from moireaug.engine import harmonics, lookup, optics
from moireaug.engine.compiling import fill, kernel, loop
from moireaug.engine.nodes import bracket
from moireaug.engine.panel import margin
from moireaug.engine.record import LANES
from moireaug.engine.sensor import attenuate, read
from moireaug.engine.view import look

ZERO, ONE = np.float32(0), np.float32(1)
SHARED = 224  # rows of tables that a photo has at least, if it has so many


@loop
def _spread_out(out, cols, first, step, per, every):
    """Fill out (lanes,) with every `step`-th column from `first` on, `per` of them in each `every` lanes."""
    w = len(cols) // step
    for i in range(len(out)):
        out[i] = cols[first + min(i // every * per + min(i % every, per - 1), w - 1) * step]


@loop
def _close_up(line, n, per, every):
    """Bring the first n pixels of a row, `per` in each `every` lanes, together again."""
    if per != every:
        for i in range(n):
            line[i] = line[i // per * every + i % per]


@kernel
def expose(raw, panel, size, camera, cell, nodes, sites, flicker, noise, key, clips):
    """Fill raw (planes, h, w) float32 with the reading of one image.

    Args:
        panel: (3, ...) float32, from `panel.show`.
        size: (height, width) of the panel in panel pixels, rounded up.
        camera, cell, nodes, sites: see `record`.
        flicker: (rows,) float64, what each sensor row gets of the mean light; empty without flicker.
        noise: whether there is any. key: (2,) uint32, as from `random_numbers.keys`.
        clips: whether the reading ends at 0 and 1.
    """
    planes, h, w = raw.shape
    kinds, count, n_k, n_l, phases = len(nodes.tables), nodes.tables.shape[1], nodes.n_k, nodes.n_l, nodes.phases
    taps, reach, px, py = nodes.taps, cell.taps, cell.period[0], cell.period[1]
    rows, cols, step = sites.rows, sites.cols, sites.step
    per, every = nodes.per, (nodes.per + LANES - 1) // LANES * LANES
    groups, volume = len(nodes.middle), kinds * n_k * n_l
    lanes, width = groups * every, n_l // 2 + 1
    # places along a row
    to_next = 2 * taps * (phases + 1)
    u, column = np.empty((planes, lanes), np.float64), np.empty((planes, lanes), np.int32)
    share, s = np.empty((planes, lanes), np.float32), np.empty((planes, lanes), np.float32)
    for plane in range(planes):
        _spread_out(u[plane], cols, sites.col[plane], step, per, every)
        for i in range(lanes):
            node, share[plane, i] = bracket(u[plane, i], cols[0], nodes.step_uw, count, 1)
            column[plane, i] = node * to_next
            s[plane, i] = (u[plane, i] - nodes.middle[i // every]) / nodes.half
    # a row's buffers
    at, whole = np.empty((2, lanes), np.float64), np.empty((3, lanes), np.int32)
    x, y, nx, ny, base = at[0], at[1], whole[0], whole[1], whole[2]
    buffers = np.empty((6, lanes), np.float32)
    dx, dy, content, light, line, numbers = (
        buffers[0], buffers[1], buffers[2], buffers[3], buffers[4], buffers[5, :w],
    )  # fmt: skip
    wx, wy = np.empty((2 * taps, lanes), np.float32), np.empty((2 * taps, lanes), np.float32)
    cx, sx = np.empty(n_k * lanes, np.float32), np.empty(n_k * lanes, np.float32)
    cy, sy = np.empty(width * lanes, np.float32), np.empty(width * lanes, np.float32)
    sums, weight = np.empty(harmonics.POWERS * lanes, np.float32), np.empty(4, np.float64)
    for wave, first in ((cx, ONE), (sx, ZERO), (cy, ONE), (sy, ZERO)):
        fill(wave[:lanes], first)
    amplitudes = np.empty(nodes.powers * groups * volume, np.float32)
    packed = np.empty((kinds, count * to_next), np.uint32)
    shared, packed_of = max(1, len(rows) // SHARED), -1
    # the panel's pixels
    stride = panel.shape[2]
    pixels = panel.reshape(3, panel.shape[1] * stride)
    step_x, step_y = np.int32(px), np.int32(py * stride)
    low, high_x = -reach - 1.0, float((size[1] + px - 1) // px + reach)
    high_y = float((size[0] + py - 1) // py + reach)
    for r in range(h * step):
        v, row = rows[r], r // step
        node, t = bracket(v, rows[0], nodes.step_v, len(nodes.cubics), 3)
        harmonics.lagrange(weight, t)
        harmonics.between(amplitudes, nodes.cubics, node, weight)
        if taps > 0 and r // shared != packed_of:
            packed_of = r // shared
            last = min(packed_of * shared + shared - 1, len(rows) - 1)
            middle = (rows[packed_of * shared] + rows[last]) / 2
            node, t = bracket(middle, rows[0], nodes.step_vw, count, 1)
            for kind in range(kinds):
                tables = nodes.tables[kind]
                optics.pack(packed[kind], tables[node], tables[node + 1], np.float32(t), phases + 1)
        gain = np.float32(camera.gain * (flicker[r] if len(flicker) > 0 else 1.0))
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            channel = sites.channel[plane]
            look(x, y, u[plane], v, camera)
            fill(light, ZERO)
            for i in range(len(cell.channel)):
                if cell.channel[i] != channel:
                    continue
                kind = cell.kind[i]
                lookup.cells(dx, nx, x, cell.centre[i, 0], float(px), low, high_x)
                lookup.cells(dy, ny, y, cell.centre[i, 1], float(py), low, high_y)
                origin = (margin(py, reach) + cell.pixel[i, 1]) * stride + margin(px, reach) + cell.pixel[i, 0]
                lookup.base_of(base, nx, ny, step_x, step_y, np.int32(origin))
                for j in range(2 * taps):
                    weights, d = (wx, dx) if j < taps else (wy, dy)
                    a, offset = j % taps * 2, j * (phases + 1)
                    lookup.weigh(
                        weights[a],
                        weights[a + 1],
                        packed[kind],
                        d,
                        column[plane],
                        share[plane],
                        phases,
                        offset,
                        to_next,
                    )
                if taps == 1:
                    lookup.nine(content, pixels[channel], base, wx, wy, step_x, step_y)
                elif taps == 2:
                    lookup.twenty_five(content, pixels[channel], base, wx, wy, step_x, step_y)
                else:
                    lookup.many(content, pixels[channel], base, wx, wy, step_x, step_y, line)
                lookup.waves(cx, sx, dx, n_k, n_l > 1)
                lookup.waves(cy, sy, dy, width, True)
                harmonics.transmit(
                    light, content, amplitudes, kind * n_k * n_l, volume, nodes.powers, nodes.order[kind],
                    cx, sx, cy, sy, s[plane], every, sums,
                )  # fmt: skip
            attenuate(light, gain, u[plane], v, camera)
            _close_up(light, w, per, every)
            read(raw[plane, row], light, camera, (plane * h + row) * w, noise, key, numbers, clips)
