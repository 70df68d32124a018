"""From raw to a photo by way of every sensor pixel's codes, one image per call, a few rows at a
time: develop, filter, clip overshoots and resize; and the backward pass from the photo to the
codes. Rows are developed only as far ahead as the filter needs them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.codes import Workspace, codes_of_row, workspace
from moireaug.engine.cpu.compiling import copy, jit_in_place, jit_inlined
from moireaug.engine.cpu.detail import (
    BLOCK_ROWS,
    Filter,
    blur_block,
    enter,
    filter_of,
    filter_row,
    first_source_row,
    rows_at_once,
    rows_needed,
)
from moireaug.engine.cpu.develop import (
    add_to_photo_rows,
    clear,
    clip,
    resize_along_row,
    source_rows,
    sum_photo_rows,
)
from moireaug.engine.cpu.vectors import gather

ZERO, ONE = np.float32(0), np.float32(1)


class _Work(NamedTuple):
    """What one image is developed in.

    Args:
        filter: see `detail.Filter`. codes: see `codes.Workspace`.
        developed: (3, rows, w) float32, the codes of the last rows of sensor pixels. filtered:
            (3, w) float32, those of one row, filtered.
    """

    filter: Filter
    codes: Workspace
    developed: np.ndarray
    filtered: np.ndarray


@jit_in_place
def _fill_unclipped(unclipped, row, y):
    """Fill row y of unclipped (3, h, w) uint8 with 1 where a clip leaves a value of a row (3, w) as
    it is, else 0."""
    for c in range(3):
        for i in range(row.shape[1]):
            unclipped[c, y, i] = np.uint8(ZERO <= row[c, i] <= ONE)


@jit_in_place
def _resize_row(out, row, y, line, rows, cols, top, bottom):
    """Add a photo's row y (3, w), clipped, to rows `top` to `bottom` of out (3, H, W); line: (W,)
    workspace."""
    for c in range(3):
        for i in range(row.shape[1]):
            row[c, i] = min(max(row[c, i], ZERO), ONE)
        gather(line, row[c], cols.index, cols.weight)
        add_to_photo_rows(out[c], line, y, rows, top, bottom)


@jit_in_place
def _resize_row_back(photo_grad, unclipped, grad, y, line, rows, cols):
    """Fill row y of photo_grad (3, h, w) from grad (3, H, W); arguments as in `_resize_row`, and
    `unclipped` as in `_fill_unclipped`."""
    for c in range(3):
        sum_photo_rows(line, grad[c], y, rows)
        gather(photo_grad[c, y], line, cols.back_index[0], cols.back_weight[0])
        for i in range(photo_grad.shape[2]):
            photo_grad[c, y, i] *= np.float32(unclipped[c, y, i])


@jit_in_place
def _develop_detail_rows(out, unclipped, raw, codes, detail, work, top, bottom):
    """Do the same as `develop_detail_image`, in buffers that it allocated."""
    f, developed, step, line = work.filter, work.developed, work.codes.step, work.codes.resized
    clear(out, top, bottom)
    first, last = source_rows(detail.rows, top, bottom)
    entered = first_source_row(f, first) // step * step
    for start in range(first, last, BLOCK_ROWS):
        end = min(start + BLOCK_ROWS, last)
        while entered < rows_needed(f, end - 1):
            r, slot = entered % step, entered % developed.shape[1]
            if r == 0:
                codes_of_row(work.codes, raw, entered // step, codes)
            for c in range(3):
                resize_along_row(developed[c, slot], work.codes, r, c, codes.cols)
            enter(f, developed, entered)
            entered += 1
        blur_block(f, start)
        for y in range(start, end):
            filter_row(work.filtered, developed, y, y - start, f)
            if len(unclipped):
                _fill_unclipped(unclipped[0], work.filtered, y)
            _resize_row(out, work.filtered, y, line, detail.rows, detail.cols, top, bottom)
    clip(out, top, bottom)


@jit_inlined
def develop_detail_image(out, unclipped, raw, codes, detail, image, top, bottom):
    """Fill rows `top` to `bottom` of out (3, H, W) float32, codes in the camera's frame, from raw
    (4 or 3, h, w) float32.

    Args:
        unclipped: (1, 3, ...) uint8, filled for `develop_detail_image_back` with 1 where the clip
            leaves the code of a sensor pixel as it is, else 0; (0, 3, ...) if not needed.
        codes, detail: see `development_records`. image: index in the batch.
    """
    w = detail.size[1]
    f = filter_of(detail, image, False)
    work = _Work(
        f,
        workspace(codes, image, raw.shape[2], out.shape[2]),
        np.empty((3, rows_at_once(f), w), np.float32),
        np.empty((3, w), np.float32),
    )
    _develop_detail_rows(out, unclipped, raw, codes, detail, work, top, bottom)


@jit_in_place
def _develop_detail_rows_back(codes_grad, grad, unclipped, detail, f, row, line):
    """Do the same as `develop_detail_image_back`, in buffers that it allocated."""
    h = codes_grad.shape[1]
    for y in range(h):
        _resize_row_back(codes_grad, unclipped, grad, y, line, detail.rows, detail.cols)
    # in place: a row is written after the last row that is made from it has entered the ring
    entered = 0
    for start in range(0, h, BLOCK_ROWS):
        end = min(start + BLOCK_ROWS, h)
        while entered < rows_needed(f, end - 1):
            enter(f, codes_grad, entered)
            entered += 1
        blur_block(f, start)
        for y in range(start, end):
            filter_row(row, codes_grad, y, y - start, f)
            for c in range(3):
                copy(codes_grad[c, y], row[c])


@jit_inlined
def develop_detail_image_back(codes_grad, grad, unclipped, detail, image):
    """Fill codes_grad (3, h, w) with the gradient in the codes of every sensor pixel, from grad
    (3, H, W) and what `develop_detail_image` filled `unclipped` with, (3, h, w)."""
    row = np.empty((3, codes_grad.shape[2]), np.float32)
    line = np.empty(grad.shape[2], np.float32)
    f = filter_of(detail, image, True)
    _develop_detail_rows_back(codes_grad, grad, unclipped, detail, f, row, line)
