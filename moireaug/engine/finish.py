"""From raw to a photo by way of every sensor pixel's codes, one image per call, a few rows at a
time: develop, filter, clip overshoots and resize; and the backward pass from the photo to the
codes. No more rows are developed ahead than the filter of those needs."""

from __future__ import annotations

import numpy as np

from moireaug.engine.codes import codes_of_row, tone_of, workspace
from moireaug.engine.compiling import copy, fill, inner, part
from moireaug.engine.detail import (
    BLOCK,
    above,
    blur_block,
    enter,
    filter_of,
    filter_row,
    held,
    needed,
)
from moireaug.engine.develop import along, blank, bound, gather, sources
from moireaug.engine.vectors import add

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


@inner
def _note(inside, row, y):
    """Note which pixels of a row (3, w) no clip changes, in inside (3, h, w)."""
    for c in range(3):
        for i in range(row.shape[1]):
            inside[c, y, i] = np.uint8(ZERO <= row[c, i] <= ONE)


@inner
def _pairs(out, row):
    for i in range(len(out)):
        out[i] = HALF * (row[2 * i] + row[2 * i + 1])


@inner
def _pairs_back(out, line):
    for i in range(len(line)):
        half = HALF * line[i]
        out[2 * i] = half
        out[2 * i + 1] = half


@inner
def _resize_row(out, row, y, line, rows, cols, top, bottom):
    """Add a photo's row y (3, w), clipped, to rows `top` to `bottom` of out (3, H, W); line: (W,)
    workspace."""
    for c in range(3):
        for i in range(row.shape[1]):
            row[c, i] = min(max(row[c, i], ZERO), ONE)
        if cols.pairs:
            _pairs(line, row[c])
        else:
            gather(line, row[c], cols.index, cols.weight)
        for i in range(rows.first[y], rows.last[y] + 1):
            if top <= i < bottom:
                add(out[c, i], line, rows.taps[i, y - rows.start[i]])


@inner
def _resize_row_back(photo_grad, inside, grad, y, line, rows, cols):
    """Fill row y of photo_grad (3, h, w) from grad (3, H, W); arguments as in `_resize_row`, and
    `inside` as in `_note`."""
    for c in range(3):
        fill(line, ZERO)
        for i in range(rows.first[y], rows.last[y] + 1):
            add(line, grad[c, i], rows.taps[i, y - rows.start[i]])
        if cols.pairs:
            _pairs_back(photo_grad[c, y], line)
        else:
            gather(photo_grad[c, y], line, cols.back_index[0], cols.back_weight[0])
        for i in range(photo_grad.shape[2]):
            photo_grad[c, y, i] *= np.float32(inside[c, y, i])


@inner
def _finish(out, inside, raw, codes, detail, f, work, tone, image, ahead, row, line, top, bottom):
    """Do the same as `finish`, in buffers that it allocated."""
    blank(out, top, bottom)
    first, last = sources(detail.rows, top, bottom)
    entered = above(f, first) // work.step * work.step
    for start in range(first, last, BLOCK):
        end = min(start + BLOCK, last)
        while entered < needed(f, end - 1):
            if entered % work.step == 0:
                codes_of_row(work, raw, entered // work.step, codes, tone, image)
            for c in range(3):
                along(ahead[c, entered % ahead.shape[1]], work, entered % work.step, c, codes.cols)
            enter(f, ahead, entered)
            entered += 1
        blur_block(f, start)
        for y in range(start, end):
            filter_row(row, ahead, y, y - start, f)
            if len(inside):
                _note(inside[0], row, y)
            _resize_row(out, row, y, line, detail.rows, detail.cols, top, bottom)
    bound(out, top, bottom)


@part
def finish(out, inside, raw, codes, detail, image, top, bottom):
    """Fill rows `top` to `bottom` of out (3, H, W) float32, codes in the camera's frame, from raw
    (4 or 3, h, w) float32.

    Args:
        inside: (1, 3, ...) uint8, filled with which codes of sensor pixels the clip lets through,
            for `finish_back`; (0, 3, ...) if not needed.
        codes, detail: see `development_records`. image: index in the batch.
    """
    w = detail.size[1]
    f, work = filter_of(detail, image, False), workspace(codes, raw.shape[2])
    ahead = np.empty((3, held(f), w), np.float32)
    row, line = np.empty((3, w), np.float32), np.empty(out.shape[2], np.float32)
    tone = tone_of(codes, image)
    _finish(out, inside, raw, codes, detail, f, work, tone, image, ahead, row, line, top, bottom)


@inner
def _finish_back(codes_grad, grad, inside, detail, f, row, line):
    """Do the same as `finish_back`, in buffers that it allocated."""
    h = codes_grad.shape[1]
    for y in range(h):
        _resize_row_back(codes_grad, inside, grad, y, line, detail.rows, detail.cols)
    # in place: a row is written after the last row that is made from it has entered the ring
    entered = 0
    for start in range(0, h, BLOCK):
        end = min(start + BLOCK, h)
        while entered < needed(f, end - 1):
            enter(f, codes_grad, entered)
            entered += 1
        blur_block(f, start)
        for y in range(start, end):
            filter_row(row, codes_grad, y, y - start, f)
            for c in range(3):
                copy(codes_grad[c, y], row[c])


@part
def finish_back(codes_grad, grad, inside, detail, image):
    """Fill codes_grad (3, h, w) with the gradient in the codes of every sensor pixel, from grad
    (3, H, W) and what `finish` filled `inside` with, (3, h, w)."""
    row = np.empty((3, codes_grad.shape[2]), np.float32)
    line = np.empty(grad.shape[2], np.float32)
    _finish_back(codes_grad, grad, inside, detail, filter_of(detail, image, True), row, line)
