"""The gradient of a full reading in what the panel shows, one image per call: `full` row by row,
transposed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.compiling import fill, once, part
from moireaug.engine.cpu.full import fill_row_weights
from moireaug.engine.cpu.irradiance import panel_irradiance_back
from moireaug.engine.cpu.rows import LIGHT, Places, Row, V, places_of, row_of
from moireaug.engine.cpu.sensor import attenuate, read_back
from moireaug.engine.cpu.vectors import add
from moireaug.engine.lower.budget import MIN_BANDS

ZERO = np.float32(0)


class _Work(NamedTuple):
    """What the gradient of a row is computed in; see `rows`. The row's irradiance holds the
    gradient in it.

    weights_x: like the row's weights_y.
    """

    places: Places
    row: Row
    weights_x: np.ndarray


@once
def _expose_rows_back(panel_grad, grad, slope, size, image, work):
    """Do the same as `expose_full_image_back`, in buffers that it allocated."""
    planes, h, _ = grad.shape
    row, places, sites = work.row, work.places, image.sites
    rows, step, light = sites.rows, sites.step, row.floats[LIGHT]
    band = max(1, len(rows) // MIN_BANDS)
    for r in range(h * step):
        v, y = rows[r], r // step
        fill_row_weights(row, image, rows, r, 0, band)
        fill(row.position[V], v)
        pulse = image.flicker[r] if len(image.flicker) > 0 else 1.0
        for first in range(planes):
            if sites.row[first] != r % step or places.first[first] != first:
                continue
            fill(row.irradiance.reshape(-1), ZERO)
            for plane in range(first, planes):
                if places.first[plane] != first:
                    continue
                read_back(light, grad[plane, y], slope[plane, y])
                attenuate(light, places.u[plane], row.position[V], image.camera)
                for colour in range(3):
                    passed = image.filters[sites.channel[plane], colour] * pulse
                    add(row.irradiance[colour], light, np.float32(passed))
            panel_irradiance_back(work, panel_grad, size, image, first, v)


@part
def expose_full_image_back(panel_grad, grad, slope, size, image):
    """Add the gradient in the panel, of its shape, from that in a reading (planes, h, w); slope,
    size and image as in `full.expose_full_image`."""
    planes, _, w = grad.shape
    places = places_of(w, planes, image.sites, image.nodes, image.filters)
    row = row_of(w, image.cell, image.nodes)
    work = _Work(places, row, np.empty(len(row.weights_y), np.float32))
    _expose_rows_back(panel_grad, grad, slope, size, image, work)
