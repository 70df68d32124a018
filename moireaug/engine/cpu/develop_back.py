"""The backward pass from a photo to its raw reading, one image per call, a cell row at a time; it
recomputes the colours of `develop`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.codes import SITES_PER_CELL, is_read, light_of_row, mix_row, workspace
from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.develop import sum_photo_rows
from moireaug.engine.cpu.physics import tone as tone_physics
from moireaug.engine.cpu.srgb import encode_and_slope
from moireaug.engine.cpu.vectors import add, gather

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


class _Gradients(NamedTuple):
    """The gradients that a backward pass works with, float32.

    Args:
        colours: of `codes.Workspace`'s shape, the gradient in the light of a cell row.
        ring: likewise, that in the prepared cell rows.
        transposed: (3, 3), of the image's matrix.
    """

    colours: np.ndarray
    ring: np.ndarray
    transposed: np.ndarray


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
    """Fill the _Gradients' colours with the gradient in the light of cell row y, which the
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
def _develop_rows_back(raw_grad, photo_grad, raw, codes, work, gradients):
    """Do the same as `develop_image_back`, in buffers that it allocated."""
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


@jit_inlined
def develop_image_back(raw_grad, photo_grad, raw, codes, image):
    """Fill raw_grad, of raw's shape, with the gradient in raw, from photo_grad (3, H, W); arguments
    as in `develop.develop_image`."""
    work = workspace(codes, image, raw.shape[2], photo_grad.shape[2])
    gradients = _Gradients(
        np.zeros(work.colours.shape, np.float32),
        np.zeros(work.ring.shape, np.float32),
        work.matrix.T.copy(),
    )
    _develop_rows_back(raw_grad, photo_grad, raw, codes, work, gradients)
