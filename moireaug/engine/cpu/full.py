"""Screen to raw, a sensor row at a time: from the panel's light to the clipped reading, and the
gradient on the way back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu import rows
from moireaug.engine.cpu.coarse_grid import bracket
from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.irradiance import panel_irradiance, panel_irradiance_back
from moireaug.engine.cpu.rows import Row, RowLayout, row_layout_of, row_of
from moireaug.engine.cpu.sensor import attenuate, read, read_back, reflect
from moireaug.engine.cpu.tap_weights import blend, weights_per_node
from moireaug.engine.cpu.vectors import add

MIN_WEIGHT_BANDS = 224  # of a photo, if it has the rows; those of a band share their tap weights
ZERO = np.float32(0)


class Work(NamedTuple):
    """What a row of a reading is computed in; see `rows`."""

    layout: RowLayout
    row: Row


@jit_inlined
def work_of_pixels(w, planes, image):
    """Return the Work of a reading w wide."""
    layout = row_layout_of(w, planes, image.sites, image.grid, image.filters)
    return Work(layout, row_of(w, image.cell, image.grid))


@jit_in_place
def fill_row_weights(weights, grid, positions, r, top):
    """Fill weights (kinds, n) with the tap weights of all nodes on row r if it is the first of its
    band, or of all that are read.

    positions: of the rows. top: the first that is read.
    """
    count = max(1, len(positions) // MIN_WEIGHT_BANDS)
    if r % count != 0 and r != top:
        return
    start = r - r % count
    end = min(start + count, len(positions)) - 1
    middle = (positions[start] + positions[end]) / 2
    kinds, nodes = grid.tables.shape[:2]
    node, t = bracket(middle, positions[0], grid.step_vw, nodes, 1)
    for kind in range(kinds):
        n = grid.columns * weights_per_node(grid.phases[kind], grid.taps[kind])[1]
        low, high = grid.tables[kind, node, :n], grid.tables[kind, node + 1, :n]
        blend(weights[kind, :n], low, high, np.float32(t))


@jit_in_place
def expose_rows(raw, slope, panel, image, work, top, bottom):
    """Fill rows `top` to `bottom` of raw (planes, h, w) float32 with the reading of one image.

    Args:
        slope: of raw's shape, filled with its derivative in the light before noise and clipping; or
            (planes, h, 0).
        panel: (3, ...) float32, from `panel.fill_panel`.
        image: see `records.Image`. work: from `work_of_pixels`.
    """
    planes, h, w = raw.shape
    row, layout, camera, sites = work.row, work.layout, image.camera, image.sites
    step = sites.step
    light, noise, bits = row.floats[rows.LIGHT], row.floats[rows.NOISE], row.ints[rows.NOISE_BITS]
    for r in range(top * step, bottom * step):
        v = sites.rows[r]
        fill_row_weights(row.weights, image.grid, sites.rows, r, top * step)
        fill(row.position[rows.V], v)
        pulse = image.flicker[r] if len(image.flicker) > 0 else 1.0
        for plane in range(planes):
            if sites.row[plane] != r % step:
                continue
            if layout.first[plane] == plane:
                panel_irradiance(work, panel, image, plane, v)
            fill(light, ZERO)
            for colour in range(3):
                passed = image.filters[sites.channel[plane], colour] * pulse
                add(light, row.irradiance[colour], np.float32(passed))
            u = layout.u[plane]
            reflect(light, u, row.position[rows.V], image.white[plane], camera)
            attenuate(light, u, row.position[rows.V], camera)
            y = r // step
            start = (plane * h + y) * w
            read(raw[plane, y], light, slope[plane, y], start, image.readout, noise, bits)


@jit_in_place
def expose_rows_back(panel_grad, grad, slope, image, work):
    """Add the gradient in the panel, of its shape, from that in a reading (planes, h, w); the rest
    as in `expose_rows`."""
    planes, h, _ = grad.shape
    row, layout, sites = work.row, work.layout, image.sites
    step, light = sites.step, row.floats[rows.LIGHT]
    for r in range(h * step):
        v, y = sites.rows[r], r // step
        fill_row_weights(row.weights, image.grid, sites.rows, r, 0)
        fill(row.position[rows.V], v)
        pulse = image.flicker[r] if len(image.flicker) > 0 else 1.0
        for first in range(planes):
            if sites.row[first] != r % step or layout.first[first] != first:
                continue
            fill(row.irradiance.reshape(-1), ZERO)
            for plane in range(first, planes):
                if layout.first[plane] != first:
                    continue
                read_back(light, grad[plane, y], slope[plane, y])
                attenuate(light, layout.u[plane], row.position[rows.V], image.camera)
                for colour in range(3):
                    passed = image.filters[sites.channel[plane], colour] * pulse
                    add(row.irradiance[colour], light, np.float32(passed))
            panel_irradiance_back(work, panel_grad, image, first, v)
