"""The gradient of a binned reading in what the panel shows, one image per call: `binned` row by
row, transposed."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import beats, stencil
from moireaug.engine.cpu.binned import add_modulated, flicker, locate_bins, work_of_bins
from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.full import fill_row_weights
from moireaug.engine.cpu.irradiance import panel_irradiance_back
from moireaug.engine.cpu.rows import LIGHT, U, V, X, Y
from moireaug.engine.cpu.sensor import attenuate, read_back
from moireaug.engine.cpu.view import look

ZERO = np.float32(0)


@jit_in_place
def _expose_rows_back(panel_grad, grad, slope, image, work):
    """Do the same as `expose_binned_image_back`, in buffers that it allocated."""
    planes, h, _ = grad.shape
    pattern, sites, row, passes = image.pattern, image.sites, work.row, work.passes
    position, first_row, light = row.position, sites.rows[0], row.floats[LIGHT]
    modulation, lines = work.modulation, work.lines
    for r in range(h):
        v = sites.rows[r]
        locate_bins(work, v, image)
        if image.stencil.taps > 0:
            stencil.look_straight(position[X], position[Y], r)
        else:
            fill_row_weights(row, image, sites.rows, r, 0)
            look(position[X], position[Y], work.layout.u[0], v, image.camera)
        beats.fill_modulation(
            modulation, lines, image.terms, pattern, passes, position, v, first_row
        )
        fill(row.irradiance.reshape(-1), ZERO)
        for plane in range(planes):
            colour = sites.channel[plane]
            read_back(light, grad[plane, r], slope[plane, r])
            attenuate(light, position[U], position[V], image.camera)
            if len(image.flicker) > 0:
                flicker(light, image.flicker, position[V], image.camera)
            for channel in range(3):
                if passes[colour, channel]:
                    passed, mean = image.filters[colour, channel], pattern.mean[channel]
                    content, beat = row.irradiance[channel], modulation[colour, channel]
                    add_modulated(content, light, beat, np.float32(passed), np.float32(mean))
        if image.stencil.taps > 0:
            content, line = row.irradiance, lines[0]
            stencil.content_back(panel_grad, content, line, image.stencil, image.cell, sites, r)
        else:
            panel_irradiance_back(work, panel_grad, image, 0, v)


@jit_inlined
def expose_binned_image_back(panel_grad, grad, slope, image):
    """Add the gradient in the panel, of its shape, from that in a binned reading (planes, h, w);
    slope and image as in `binned.expose_binned_image`."""
    planes, _, w = grad.shape
    _expose_rows_back(panel_grad, grad, slope, image, work_of_bins(w, planes, image))
