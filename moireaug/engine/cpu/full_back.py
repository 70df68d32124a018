"""The gradient of a full reading in what the panel shows, one image per call: `full` row by row,
transposed."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.full import fill_row_weights, work_of_pixels
from moireaug.engine.cpu.irradiance import panel_irradiance_back
from moireaug.engine.cpu.rows import LIGHT, V
from moireaug.engine.cpu.sensor import attenuate, read_back
from moireaug.engine.cpu.vectors import add

ZERO = np.float32(0)


@jit_in_place
def _expose_rows_back(panel_grad, grad, slope, image, work):
    """Do the same as `expose_full_image_back`, in buffers that it allocated."""
    planes, h, _ = grad.shape
    row, layout, sites = work.row, work.layout, image.sites
    rows, step, light = sites.rows, sites.step, row.floats[LIGHT]
    for r in range(h * step):
        v, y = rows[r], r // step
        fill_row_weights(row, image, rows, r, 0)
        fill(row.position[V], v)
        pulse = image.flicker[r] if len(image.flicker) > 0 else 1.0
        for first in range(planes):
            if sites.row[first] != r % step or layout.first[first] != first:
                continue
            fill(row.irradiance.reshape(-1), ZERO)
            for plane in range(first, planes):
                if layout.first[plane] != first:
                    continue
                read_back(light, grad[plane, y], slope[plane, y])
                attenuate(light, layout.u[plane], row.position[V], image.camera)
                for colour in range(3):
                    passed = image.filters[sites.channel[plane], colour] * pulse
                    add(row.irradiance[colour], light, np.float32(passed))
            panel_irradiance_back(work, panel_grad, image, first, v)


@jit_inlined
def expose_full_image_back(panel_grad, grad, slope, image):
    """Add the gradient in the panel, of its shape, from that in a reading (planes, h, w); slope
    and image as in `full.expose_full_image`."""
    planes, _, w = grad.shape
    _expose_rows_back(panel_grad, grad, slope, image, work_of_pixels(w, planes, image))
