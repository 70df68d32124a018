"""Screen to a binned reading, one image per call: the content of the picture at each photo pixel,
times the share of the panel that is lit there, a row at a time."""

from __future__ import annotations

import numpy as np

from moireaug.engine import beats
from moireaug.engine.compiling import fill, inner, once, part
from moireaug.engine.expose import BANDS, cell_weights
from moireaug.engine.glow import glow
from moireaug.engine.random_numbers import keys
from moireaug.engine.rows import BITS, LIGHT, NUMBERS, X, Y, places_of, row_of
from moireaug.engine.sensor import attenuate, clip_mean, read, reflect

ZERO = np.float32(0)


@inner
def _add_lit(light, content, modulation, passed, mean):
    for i in range(len(light)):
        light[i] += content[i] * (passed * (mean + modulation[i]))


@inner
def _fill_asked(asked, filters):
    """Fill asked (3, 3) with which channels each colour filter passes."""
    for plane in range(3):
        for channel in range(3):
            asked[plane, channel] = filters[plane, channel] != 0


@once
def _expose(
    raw, panel, size, camera, cell, nodes, sites, terms, given, noise_keys, places, row, work, top,
    bottom,
):  # fmt: skip
    """Do the same as `expose`, in buffers that it allocated."""
    planes, h, w = raw.shape
    modulation, lines, weight, asked = work
    light, numbers, bits = row.line[LIGHT], row.line[NUMBERS], row.whole[BITS]
    u, band = places.u[0], max(1, h // BANDS)
    for r in range(top, bottom):
        v = sites.rows[r]
        if r % band == 0 or r == top:
            start = r - r % band
            middle = (sites.rows[start] + sites.rows[min(start + band, h) - 1]) / 2
            cell_weights(row.weights, nodes, middle, sites.rows[0])
        pulse = given.flicker[r] if len(given.flicker) > 0 else 1.0
        glow(row, panel, size, camera, cell, nodes, sites, places, 0, v)
        beats.modulate(
            modulation, lines, weight, terms, given.coefficients, asked, row.at[X], row.at[Y], u, v,
            sites.rows[0], given.bayer,
        )  # fmt: skip
        for plane in range(planes):
            colour = sites.channel[plane]
            fill(light, ZERO)
            for channel in range(3):
                if asked[colour, channel]:
                    passed = np.float32(given.filters[colour, channel] * pulse)
                    mean = np.float32(given.mean[channel])
                    _add_lit(light, row.glow[channel], modulation[colour, channel], passed, mean)
            reflect(light, u, v, given.white[plane], camera)
            attenuate(light, u, v, camera)
            out, start = raw[plane, r], (plane * h + r) * w
            read(out, light, camera, start, given.noise, noise_keys, numbers, bits, False)
            if given.clips:
                pattern = terms.pattern[colour] if given.saturates else ZERO
                clip_mean(out, given.away[0], given.away[1], pattern)


@part
def expose(raw, panel, size, camera, cell, nodes, sites, terms, given, seed, top, bottom):
    """Fill rows `top` to `bottom` of raw (planes, h, w) float32 with the binned reading of one
    image.

    Args:
        panel: (3, ...) float32, from `panel.show`.
        size: (height, width) of the panel in panel pixels, rounded up.
        camera, cell, nodes, sites, terms, given: see `exposure_records`. seed: int64, of the noise.
    """
    planes, _, w = raw.shape
    places, row = places_of(w, planes, sites, nodes, given.shown), row_of(w, cell, nodes)
    work = (
        np.empty((3, 3, w), np.float32),
        np.empty((5, w), np.float32),
        np.empty(4, np.float32),
        np.empty((3, 3), np.bool_),
    )
    _fill_asked(work[3], given.filters)
    _expose(
        raw, panel, size, camera, cell, nodes, sites, terms, given, keys(seed), places, row, work,
        top, bottom,
    )  # fmt: skip
