"""Screen to a binned reading, a row at a time: the content of the picture in each bin, times the
share of the panel that is lit there; and the gradient on the way back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu import beats, rows, stencil
from moireaug.engine.cpu.compiling import copy, fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.full import fill_row_weights
from moireaug.engine.cpu.irradiance import panel_irradiance, panel_irradiance_back
from moireaug.engine.cpu.register import ImageToPhoto, fill_photo_positions, image_to_photo
from moireaug.engine.cpu.rows import Row, RowLayout, U, V, X, Y, row_layout_of, row_of
from moireaug.engine.cpu.sensor import add_noise, attenuate, clip_mean, read_back, reflect
from moireaug.engine.cpu.view import inverse, look

ZERO = np.float32(0)


class _Work(NamedTuple):
    """What a row of bins is computed in.

    Args:
        layout, row: see `rows`. modulation: (3, 3, w) float32, see `beats.fill_modulation`. lines:
            (5, w) float32. passes: (3, 3) bool, which channels each colour filter passes.
        ideal, to_photo: see `register.fill_photo_positions`; of a rectified camera.
    """

    layout: RowLayout
    row: Row
    modulation: np.ndarray
    lines: np.ndarray
    passes: np.ndarray
    ideal: np.ndarray
    to_photo: ImageToPhoto


@jit_inlined
def _image_to_photo(sensor):
    """Return the ImageToPhoto of bins that lie in the image's frame; the others need none."""
    forward = np.array(inverse(sensor)).reshape(3, 3)
    k1, k2 = (sensor.k1, sensor.k2) if sensor.rectified != 0 else (0.0, 0.0)
    return image_to_photo(forward, k1, k2)


@jit_inlined
def work_of_bins(w, planes, image):
    """Return the _Work of a reading w wide."""
    passes = np.empty((3, 3), np.bool_)
    for i in range(3):
        for j in range(3):
            passes[i, j] = image.filters[i, j] != 0
    every_colour = np.ones((3, 3))  # in the irradiance; filters come after the beats
    return _Work(
        row_layout_of(w, planes, image.sites, image.grid, every_colour),
        row_of(w, image.cell, image.grid),
        np.empty((3, 3, w), np.float32),
        np.empty((5, w), np.float32),
        passes,
        np.empty((3, w), np.float64),
        _image_to_photo(image.bins.sensor),
    )


@jit_in_place
def locate_bins(work, v, image):
    """Fill where a row of the bins, v about the centre, lies on the photo."""
    at, sensor = work.row.position, image.bins.sensor
    if sensor.rectified != 0:
        first = image.sites.cols[0]
        fill_photo_positions(at[U], at[V], work.ideal, first, v, work.to_photo, sensor)
        return
    u = work.layout.u[0]
    for i in range(len(u)):
        at[U, i], at[V, i] = u[i], v


@jit_in_place
def flicker(light, bands, v, camera):
    """Multiply a row by the panel's pulses at photo rows v (w,) about the centre."""
    last = len(bands) - 2.0
    for i in range(len(light)):
        at = min(max((v[i] - camera.pulses_top) / camera.pulses_height * last, 0.0), last)
        k = int(at)
        light[i] *= np.float32(bands[k] + (at - k) * (bands[k + 1] - bands[k]))


@jit_in_place
def add_modulated(light, content, modulation, passed, mean):
    """Add a row of content, modulated, to the light, or a row of light's gradient to the content's;
    passed: of it by the colour filter."""
    for i in range(len(light)):
        light[i] += content[i] * (passed * (mean + modulation[i]))


@jit_in_place
def expose_rows(raw, slope, panel, image, work, top, bottom):
    """Do the same as `full.expose_rows` for a binned reading.

    work: from `work_of_bins`.
    """
    planes, h, w = raw.shape
    bins, sites, pattern = image.bins, image.sites, image.bins.pattern
    row, passes, modulation = work.row, work.passes, work.modulation
    position, first_row = row.position, sites.rows[0]
    light, noise, bits = row.floats[rows.LIGHT], row.floats[rows.NOISE], row.ints[rows.NOISE_BITS]
    for r in range(top, bottom):
        v = sites.rows[r]
        locate_bins(work, v, image)
        if bins.stencil.taps > 0:
            stencil.look_straight(position[X], position[Y], r)
            line = work.lines[0]
            stencil.content(row.irradiance, line, bins.stencil, panel, image.cell, sites, r)
        else:
            fill_row_weights(row.weights, image.grid, sites.rows, r, top)
            panel_irradiance(work, panel, image, 0, v)
        beats.fill_modulation(
            modulation, work.lines, bins.terms, pattern, passes, position, v, first_row
        )
        for plane in range(planes):
            colour = sites.channel[plane]
            fill(light, ZERO)
            for channel in range(3):
                if passes[colour, channel]:
                    passed, beat = image.filters[colour, channel], modulation[colour, channel]
                    content, mean = row.irradiance[channel], pattern.mean[channel]
                    add_modulated(light, content, beat, np.float32(passed), np.float32(mean))
            if len(image.flicker) > 0:
                flicker(light, image.flicker, position[V], image.camera)
            reflect(light, position[U], position[V], image.white[plane], image.camera)
            attenuate(light, position[U], position[V], image.camera)
            out, away = raw[plane, r], pattern.lost_noise_variance
            add_noise(light, slope[plane, r], (plane * h + r) * w, image.readout, noise, bits)
            if image.readout.clips:
                lost = bins.terms.lost_pattern_variance[colour] if pattern.saturates else ZERO
                clip_mean(out, light, slope[plane, r], away[0], away[1], lost)
            else:
                copy(out, light)


@jit_in_place
def expose_rows_back(panel_grad, grad, slope, image, work):
    """Do the same as `full.expose_rows_back` for a binned reading."""
    planes, h, _ = grad.shape
    bins, sites, row, passes = image.bins, image.sites, work.row, work.passes
    pattern = bins.pattern
    position, first_row, light = row.position, sites.rows[0], row.floats[rows.LIGHT]
    modulation, lines = work.modulation, work.lines
    for r in range(h):
        v = sites.rows[r]
        locate_bins(work, v, image)
        if bins.stencil.taps > 0:
            stencil.look_straight(position[X], position[Y], r)
        else:
            fill_row_weights(row.weights, image.grid, sites.rows, r, 0)
            look(position[X], position[Y], work.layout.u[0], v, image.camera)
        beats.fill_modulation(
            modulation, lines, bins.terms, pattern, passes, position, v, first_row
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
        if bins.stencil.taps > 0:
            content, line = row.irradiance, lines[0]
            stencil.content_back(panel_grad, content, line, bins.stencil, image.cell, sites, r)
        else:
            panel_irradiance_back(work, panel_grad, image, 0, v)
