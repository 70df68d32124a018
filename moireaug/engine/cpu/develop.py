"""Raw to photo, a cell row at a time: to codes, and resized; and the gradient on the way back, for
which the colours are computed again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.codes import SITES_PER_CELL, codes_of_row, is_read, light_of_row, mix_row
from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.physics import tone as tone_physics
from moireaug.engine.cpu.srgb import encode_and_slope
from moireaug.engine.cpu.vectors import add, gather, load, store

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


@jit_in_place
def _mean(out, even, odd):
    for i in range(len(out)):
        store(out, i, HALF * (load(even, i) + load(odd, i)))


@jit_in_place
def source_rows(rows, top, bottom):
    """Return the first and one past the last sensor row that photo rows `top` to `bottom` are made
    from."""
    if bottom <= top:
        return 0, 0
    return rows.start[top], min(rows.start[bottom - 1] + rows.taps.shape[1], len(rows.first))


@jit_in_place
def resize_along_row(line, work, r, channel, cols):
    """Fill line (W,) with one colour of row r of a cell, resized."""
    if work.step == 2 and cols.halves:  # by `gather`, developing takes 1.4 times as long
        _mean(line, work.colours[2 * r, channel], work.colours[2 * r + 1, channel])
        return
    # the index counts on from the even columns to the odd ones, 3 rows of lanes further on
    start = (2 * r * 3 + channel) * work.lanes
    gather(line, work.colours.reshape(-1)[start:], cols.index, cols.weight)


@jit_in_place
def add_to_photo_rows(photo, line, row, rows, top, bottom):
    """Add a line (W,) of a sensor row, weighed, to rows `top` to `bottom` of one colour of a photo
    (H, W)."""
    for i in range(rows.first[row], rows.last[row] + 1):
        if top <= i < bottom:
            add(photo[i], line, rows.taps[i, row - rows.start[i]])


@jit_in_place
def sum_photo_rows(line, grad, row, rows):
    """Fill a line (W,) with the gradient in that of a sensor row, from that in a colour of a photo
    (H, W)."""
    fill(line, ZERO)
    for i in range(rows.first[row], rows.last[row] + 1):
        add(line, grad[i], rows.taps[i, row - rows.start[i]])


@jit_in_place
def clear(photo, top, bottom):
    """Fill rows `top` to `bottom` of photo (3, H, W) with zeros."""
    for c in range(3):
        fill(photo[c, top:bottom].reshape(-1), ZERO)


@jit_in_place
def clip(photo, top, bottom):
    """Clip rows `top` to `bottom` of photo (3, H, W): sums of weighted codes round to just above 1.

    The backward pass leaves this out, as the codes themselves lie in [0, 1]."""
    for c in range(3):
        rows = photo[c, top:bottom].reshape(-1)
        for i in range(len(rows)):
            rows[i] = min(max(rows[i], ZERO), ONE)


@jit_in_place
def develop_rows(photo, raw, codes, work, top, bottom):
    """Fill rows `top` to `bottom` of photo (3, H, W) float32, codes in the camera's frame, from raw
    (4 or 3, h, w) float32.

    codes: see `development_records.Codes`. work: from `codes.workspace`.
    """
    rows, line = codes.rows, work.resized
    clear(photo, top, bottom)
    first, last = source_rows(rows, top, bottom)
    for y in range(first // work.step, (last + work.step - 1) // work.step):
        codes_of_row(work, raw, y, codes)
        for r in range(work.step):
            row = y * work.step + r
            if not is_read(rows, row):
                continue
            for channel in range(3):
                resize_along_row(line, work, r, channel, codes.cols)
                add_to_photo_rows(photo[channel], line, row, rows, top, bottom)
    clip(photo, top, bottom)


class Gradients(NamedTuple):
    """The gradients that a backward pass works with, float32.

    Args:
        colours: of `codes.Workspace`'s shape, the gradient in the light of a cell row.
        ring: likewise, that in the prepared cell rows.
        transposed: (3, 3), of the image's matrix.
    """

    colours: np.ndarray
    ring: np.ndarray
    transposed: np.ndarray


@jit_inlined
def gradients_of(work):
    """Return the Gradients of a workspace."""
    return Gradients(
        np.zeros(work.colours.shape, np.float32),
        np.zeros(work.ring.shape, np.float32),
        work.matrix.T.copy(),
    )


@jit_in_place
def _code_slope(out, light, gain, tone):
    """Multiply a gradient by the slope of `codes._code` at `light`. A clip's slope is 1 at its
    bounds, and 0 beyond."""
    shoulder, contrast = tone.shoulder, tone.contrast
    for i in range(len(out)):
        x = light[i] * gain
        code, slope = encode_and_slope(x) if tone.coded else (x, ONE)
        slope *= gain
        if tone.toned:
            slope = slope if ZERO <= code <= ONE else ZERO
            code = min(max(code, ZERO), ONE)
            code, steepness = tone_physics.shoulder_and_slope(code, shoulder)
            slope *= steepness
            slope *= tone_physics.contrast_slope(code, contrast)
            code = tone_physics.contrast_curve(code, contrast)
        code += tone.brighten
        out[i] *= slope if ZERO <= code <= ONE else ZERO


@jit_in_place
def _resize_along_row_back(even, odd, line, step, w, cols):
    """Fill a cell row's even columns, and the odd ones if there are any, with the gradient in them,
    from that in the resized row."""
    gather(even[:w], line, cols.back_index[0], cols.back_weight[0])
    if step == 2:
        gather(odd[:w], line, cols.back_index[1], cols.back_weight[1])


@jit_in_place
def _fold_back(raw_grad, total, raw, y, saturates):
    """Fill cell row y of raw_grad from the gradient `total` of its prepared row, which is reset
    to 0."""
    w, wide = raw.shape[2], len(total) // SITES_PER_CELL
    for plane in range(SITES_PER_CELL):
        line = total[plane * wide : plane * wide + w + 2]
        out, reading = raw_grad[plane, y], raw[plane, y]
        line[1] += line[0]
        line[w] += line[w + 1]
        for i in range(w):
            out[i] = line[i + 1] if not saturates or reading[i] <= ONE else ZERO
        fill(line, ZERO)


@jit_in_place
def _light_back(gradients, photo_grad, y, codes, work):
    """Fill the Gradients' colours with the gradient in the light of cell row y, which the
    workspace holds, from photo_grad (3, H, W)."""
    step, w, matrix, line = work.step, work.width, work.matrix, work.resized
    grads = gradients.colours
    for site in range(SITES_PER_CELL):
        for channel in range(3):
            fill(grads[site, channel], ZERO)
    for r in range(step):
        row = y * step + r
        if not is_read(codes.rows, row):
            continue
        if codes.mixes:
            mix_row(work.colours, r, step, w, matrix)
        for channel in range(3):
            gain = ONE if codes.mixes else matrix[channel, channel]
            sum_photo_rows(line, photo_grad[channel], row, codes.rows)
            even, odd = grads[2 * r, channel], grads[2 * r + 1, channel]
            _resize_along_row_back(even, odd, line, step, w, codes.cols)
            for site in range(2 * r, 2 * r + step):
                light = work.colours[site, channel, :w]
                _code_slope(grads[site, channel, :w], light, gain, work.tone)
        if codes.mixes:
            mix_row(grads, r, step, w, gradients.transposed)


@jit_in_place
def _demosaic_back(gradients, y, h, codes, work):
    """Add the gradient in the colours of cell row y to that in the rows they are made from."""
    w, demosaic = work.width, codes.demosaic
    for site in range(SITES_PER_CELL):
        if not is_read(codes.rows, 2 * y + site // 2):
            continue
        for channel in range(3):
            colour = gradients.colours[site, channel, :w]
            for dy in range(-1, 2):
                target = gradients.ring[min(max(y + dy, 0), h - 1) % 3]
                first = demosaic.first[site, channel, dy + 1]
                for tap in range(first, first + demosaic.count[site, channel, dy + 1]):
                    offset = demosaic.offset[tap]
                    add(target[offset : offset + w], colour, demosaic.weight[tap])


@jit_in_place
def _colour_back(raw_grad, grads, plane, raw, codes):
    """Fill a plane's row of raw_grad (w,) from the gradient in the colours of its row (3, lanes),
    of which a cell's two greens have half each."""
    has_two_greens = codes.planes == SITES_PER_CELL
    channel = plane - 1 if has_two_greens and plane > 1 else plane
    share = HALF if has_two_greens and channel == 1 else ONE
    for i in range(len(raw)):
        passes = not codes.saturates or raw[i] <= ONE
        raw_grad[i] = share * grads[channel, i] if passes else ZERO


@jit_in_place
def develop_rows_back(raw_grad, photo_grad, raw, codes, work, gradients):
    """Fill raw_grad, of raw's shape, with the gradient in raw, from photo_grad (3, H, W);
    gradients: from `gradients_of`, the rest as in `develop_rows`."""
    h = raw.shape[1]
    grads, total = gradients.colours, gradients.ring
    for y in range(h):
        light_of_row(work, raw, y, codes)
        _light_back(gradients, photo_grad, y, codes, work)
        if codes.mosaic:
            _demosaic_back(gradients, y, h, codes, work)
            # no later row adds to the row above
            if y > 0:
                _fold_back(raw_grad, total[(y - 1) % 3], raw, y - 1, codes.saturates)
            continue
        for plane in range(codes.planes):
            _colour_back(raw_grad[plane, y], grads[0], plane, raw[plane, y], codes)
    if codes.mosaic:
        _fold_back(raw_grad, total[(h - 1) % 3], raw, h - 1, codes.saturates)
