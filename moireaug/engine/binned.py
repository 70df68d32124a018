"""Screen to a binned reading, one image per call: the content of the picture in each bin, times the
share of the panel that is lit there, a row at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine import beats, stencil
from moireaug.engine.compiling import fill, inner, once, part
from moireaug.engine.expose import BANDS, cell_weights
from moireaug.engine.glow import glow
from moireaug.engine.random_numbers import keys
from moireaug.engine.register import photo_row, undistortion
from moireaug.engine.rows import BITS, LIGHT, NUMBERS, Places, Row, U, V, X, Y, places_of, row_of
from moireaug.engine.sensor import attenuate, clip_mean, read, reflect
from moireaug.engine.view import inverse

ZERO = np.float32(0)


class _Work(NamedTuple):
    """What a row of bins is computed in.

    Args:
        places, row: see there. modulation: (3, 3, w) float32, see `beats.modulate`. lines: (5, w)
            float32. asked: (3, 3) bool, which channels each colour filter passes.
        ideal: (3, w), forward: (3, 3), factor: (n,) and per_square, float64, see
            `register.photo_row`.
    """

    places: Places
    row: Row
    modulation: np.ndarray
    lines: np.ndarray
    asked: np.ndarray
    ideal: np.ndarray
    forward: np.ndarray
    factor: np.ndarray
    per_square: float


@part
def _work_of(w, planes, image):
    """Return the _Work of a reading w wide."""
    filters, forward = image.given.filters, np.empty((3, 3), np.float64)
    asked = np.empty((3, 3), np.bool_)
    back = inverse(image.sensor)
    for i in range(3):
        for j in range(3):
            asked[i, j] = filters[i, j] != 0
            forward[i, j] = back[3 * i + j]
    factor, per_square = undistortion(image.sensor.k1, image.sensor.k2)
    return _Work(
        places_of(w, planes, image.sites, image.nodes, image.given.shown),
        row_of(w, image.cell, image.nodes),
        np.empty((3, 3, w), np.float32),
        np.empty((5, w), np.float32),
        asked,
        np.empty((3, w), np.float64),
        forward,
        factor,
        per_square,
    )


@inner
def _place(work, r, v, sensor, size):
    """Fill where row r of the bins, v about the centre, lies on the photo."""
    at = work.row.at
    if sensor.rectified != 0:
        photo_row(at[U], at[V], work.ideal, r, work.forward, work.factor, work.per_square, size)
        return
    u = work.places.u[0]
    for i in range(len(u)):
        at[U, i], at[V, i] = u[i], v


@inner
def _pulse(light, bands, v, height):
    """Multiply a row by the panel's pulses at photo rows v (w,) about the centre."""
    last = len(bands) - 2.0
    for i in range(len(light)):
        at = min(max((v[i] / height + 0.5) * last, 0.0), last)
        k = int(at)
        light[i] *= np.float32(bands[k] + (at - k) * (bands[k + 1] - bands[k]))


@inner
def _add_lit(light, content, modulation, passed, mean):
    for i in range(len(light)):
        light[i] += content[i] * (passed * (mean + modulation[i]))


@once
def _expose(raw, panel, size, image, work, noise_keys, top, bottom):
    """Do the same as `expose`, in buffers that it allocated."""
    planes, h, w = raw.shape
    given, camera, nodes, sites = image.given, image.camera, image.nodes, image.sites
    row, places = work.row, work.places
    light, numbers, bits = row.line[LIGHT], row.line[NUMBERS], row.whole[BITS]
    band = max(1, h // BANDS)
    for r in range(top, bottom):
        v = sites.rows[r]
        _place(work, r, v, image.sensor, (h, w))
        if image.stencil.taps > 0:
            stencil.look_straight(row.at[X], row.at[Y], r)
            stencil.content(row.glow, work.lines[0], image.stencil, panel, image.cell, sites, r)
        else:
            if r % band == 0 or r == top:
                start = r - r % band
                middle = (sites.rows[start] + sites.rows[min(start + band, h) - 1]) / 2
                cell_weights(row.weights, nodes, middle, sites.rows[0])
            glow(row, panel, size, camera, image.cell, nodes, sites, places, 0, v)
        beats.modulate(
            work.modulation, work.lines, image.terms, given, work.asked, row.at, v, sites.rows[0]
        )
        for plane in range(planes):
            colour = sites.channel[plane]
            fill(light, ZERO)
            for channel in range(3):
                if work.asked[colour, channel]:
                    passed = np.float32(given.filters[colour, channel])
                    mean, modulation = np.float32(given.mean[channel]), work.modulation
                    _add_lit(light, row.glow[channel], modulation[colour, channel], passed, mean)
            if len(given.flicker) > 0:
                _pulse(light, given.flicker, row.at[V], h)
            reflect(light, row.at[U], row.at[V], given.white[plane], camera)
            attenuate(light, row.at[U], row.at[V], camera)
            out, start = raw[plane, r], (plane * h + r) * w
            read(out, light, camera, start, given.noise, noise_keys, numbers, bits, False)
            if given.clips:
                pattern = image.terms.pattern[colour] if given.saturates else ZERO
                clip_mean(out, given.away[0], given.away[1], pattern)


@part
def expose(raw, panel, size, image, seed, top, bottom):
    """Fill rows `top` to `bottom` of raw (planes, h, w) float32 with the binned reading of one
    image.

    Args:
        panel: (3, ...) float32, from `panel.show`.
        size: (height, width) of the panel in panel pixels, rounded up.
        image: see `exposure_records.BinnedImage`. seed: int64, of the noise.
    """
    planes, _, w = raw.shape
    _expose(raw, panel, size, image, _work_of(w, planes, image), keys(seed), top, bottom)
