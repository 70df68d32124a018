"""A row of a reading as codes: saturation, demosaicing, white balance and encoding."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.compiling import copy, fill, jit, jit_in_place
from moireaug.engine.cpu.physics import tone as tone_physics
from moireaug.engine.cpu.srgb import encode
from moireaug.engine.cpu.vectors import LANES, add_sum, padded_width

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
SITES_PER_CELL = 4  # sensor pixels of a colour filter cell


class Tone(NamedTuple):
    """How one image's light becomes codes; see `development_records.Codes`.

    Passing it to a function costs little, unlike a record of arrays.
    """

    coded: bool
    toned: bool
    shoulder: np.float32
    contrast: np.float32
    brighten: np.float32


class Workspace(NamedTuple):
    """What the development of one image works with.

    Args:
        step: rows, and columns, of sensor pixels in a cell. width: cells in a row. lanes: width
            with padding.
        matrix: (3, 3) float32, see `development_records.Codes`.
        colours: (4 sites, 3, lanes) float32, the colours of a cell row. A site's index is twice its
            row plus its column in the cell.
        ring: (3, 4 planes * (lanes + LANES)) float32, prepared cell rows. ring_rows: (3,) int64,
            the cell rows that it holds.
        resized: (W,) float32, one colour of a sensor row at the photo's width.
    """

    step: int
    width: int
    lanes: int
    tone: Tone
    matrix: np.ndarray
    colours: np.ndarray
    ring: np.ndarray
    ring_rows: np.ndarray
    resized: np.ndarray


@jit
def workspace(codes, image, raw_width, photo_width):
    """Return the Workspace of a reading `raw_width` pixels wide; image: index in the batch."""
    lanes = padded_width(raw_width)
    tone = Tone(
        codes.coded,
        codes.toned,
        codes.shoulder[image],
        codes.contrast[image],
        codes.brighten[image],
    )
    ring_rows = np.empty(3, np.int64)
    fill(ring_rows, -1)
    return Workspace(
        2 if codes.mosaic else 1,
        raw_width,
        lanes,
        tone,
        codes.matrix[image],
        np.zeros((SITES_PER_CELL, 3, lanes), np.float32),
        np.zeros((3, SITES_PER_CELL * (lanes + LANES)), np.float32),
        ring_rows,
        np.empty(photo_width, np.float32),
    )


@jit_in_place
def is_read(rows, row):
    """Return whether any photo pixel is made from this sensor row."""
    return rows.first[row] <= rows.last[row]


@jit_in_place
def _prepare(out, raw, saturates, levels):
    """Copy a plane's row (w,) to out (w + 2,), its end values repeated: saturated if `saturates`,
    and rounded if levels > 0."""
    w = len(raw)
    for i in range(w):
        value = raw[i]
        if saturates:
            value = min(value, ONE)
        out[i + 1] = value
    if levels > 0:
        for i in range(w):
            out[i + 1] = np.rint(min(max(out[i + 1], ZERO), ONE) * levels) / levels
    out[0], out[w + 1] = out[1], out[w]


@jit_in_place
def _mix(red, green, blue, matrix):
    """Multiply the colours of a row by a matrix (3, 3), in place."""
    rr, rg, rb = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    gr, gg, gb = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    br, bg, bb = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    for i in range(len(red)):
        r, g, b = red[i], green[i], blue[i]
        red[i] = rr * r + rg * g + rb * b
        green[i] = gr * r + gg * g + gb * b
        blue[i] = br * r + bg * g + bb * b


@jit_in_place
def _code(out, gain, tone):
    """Turn a row of an image's light into codes, in place."""
    shoulder, contrast = tone.shoulder, tone.contrast
    if tone.coded:
        for i in range(len(out)):
            out[i] = encode(out[i] * gain)
    else:
        for i in range(len(out)):
            out[i] *= gain
    if tone.toned:
        for i in range(len(out)):
            x = tone_physics.shoulder_curve(min(max(out[i], ZERO), ONE), shoulder)
            out[i] = tone_physics.contrast_curve(x, contrast)
    for i in range(len(out)):
        out[i] = min(max(out[i] + tone.brighten, ZERO), ONE)


@jit_in_place
def _colours(colours, ring, y, h, demosaic, rows):
    """Fill the workspace's colours with those of cell row y, from the prepared rows in its ring."""
    for site in range(SITES_PER_CELL):
        if not is_read(rows, 2 * y + site // 2):
            continue
        for channel in range(3):
            colour = colours[site, channel]
            fill(colour, ZERO)
            for dy in range(-1, 2):
                row = min(max(y + dy, 0), h - 1) % 3
                first = demosaic.first[site, channel, dy + 1]
                count = demosaic.count[site, channel, dy + 1]
                if not count:
                    continue
                weight = demosaic.weight[first : first + count]
                add_sum(colour, weight, ring[row], demosaic.offset[first : first + count])


@jit_in_place
def _enter(ring, ring_rows, raw, y, saturates, levels):
    """Prepare cell row y of the packed planes in the ring, unless it is there already."""
    if ring_rows[y % 3] == y:
        return
    w, wide = raw.shape[2], ring.shape[1] // SITES_PER_CELL
    for plane in range(SITES_PER_CELL):
        start = plane * wide
        _prepare(ring[y % 3, start : start + w + 2], raw[plane, y], saturates, levels)
    ring_rows[y % 3] = y


@jit_in_place
def _average(green, other):
    """Make a row of one green the mean of a cell's two."""
    for i in range(len(other)):
        green[i] = HALF * (green[i] + other[i])


@jit_in_place
def light_of_row(work, raw, y, codes):
    """Fill the workspace's colours with those of row y of raw: of four sites, or of one where the
    sensor has no colour filters."""
    _, h, w = raw.shape
    ring, saturates, levels = work.ring, codes.saturates, codes.levels
    if codes.mosaic:
        for dy in range(-1, 2):
            _enter(ring, work.ring_rows, raw, min(max(y + dy, 0), h - 1), saturates, levels)
        _colours(work.colours, ring, y, h, codes.demosaic, codes.rows)
        return
    for channel, plane in enumerate((0, 1, codes.planes - 1)):
        _prepare(ring[0], raw[plane, y], saturates, levels)
        copy(work.colours[0, channel], ring[0, 1 : w + 1])
    if codes.planes == SITES_PER_CELL:
        _prepare(ring[0], raw[2, y], saturates, levels)
        _average(work.colours[0, 1], ring[0, 1 : w + 1])


@jit_in_place
def mix_row(colours, r, step, w, matrix):
    """Multiply the colours of one row of a cell, its even and its odd columns, by a matrix."""
    for site in range(2 * r, 2 * r + step):
        _mix(colours[site, 0, :w], colours[site, 1, :w], colours[site, 2, :w], matrix)


@jit_in_place
def codes_of_row(work, raw, y, codes):
    """Fill the workspace's colours with the codes of row y of raw."""
    w, matrix = raw.shape[2], work.matrix
    light_of_row(work, raw, y, codes)
    for r in range(work.step):
        if not is_read(codes.rows, y * work.step + r):
            continue
        if codes.mixes:
            mix_row(work.colours, r, work.step, w, matrix)
        for channel in range(3):
            gain = ONE if codes.mixes else matrix[channel, channel]
            for site in range(2 * r, 2 * r + work.step):
                _code(work.colours[site, channel, :w], gain, work.tone)
