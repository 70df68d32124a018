"""The kernels of developing, and of its gradient, that Python calls; see `expose_kernels`. Where
detail is filtered, by way of every sensor pixel's codes: rows are developed as far ahead as the
filter needs them, filtered, clipped and resized."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu import detail as filtering
from moireaug.engine.cpu import develop, register
from moireaug.engine.cpu.codes import Workspace, codes_of_row, workspace
from moireaug.engine.cpu.compiling import copy, fill, jit_in_place, jit_inlined, kernel
from moireaug.engine.cpu.vectors import gather

ZERO, ONE = np.float32(0), np.float32(1)


class DetailWork(NamedTuple):
    """What one image is developed in.

    Args:
        filter: see `detail.Filter`. codes: see `codes.Workspace`.
        developed: (3, rows, w) float32, the codes of the last rows of sensor pixels. filtered:
            (3, w) float32, those of one row, filtered.
    """

    filter: filtering.Filter
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
        develop.add_to_photo_rows(out[c], line, y, rows, top, bottom)


@jit_in_place
def _resize_row_back(photo_grad, unclipped, grad, y, line, rows, cols):
    """Fill row y of photo_grad (3, h, w) from grad (3, H, W); arguments as in `_resize_row`, and
    `unclipped` as in `_fill_unclipped`."""
    for c in range(3):
        develop.sum_photo_rows(line, grad[c], y, rows)
        gather(photo_grad[c, y], line, cols.back_index[0], cols.back_weight[0])
        for i in range(photo_grad.shape[2]):
            photo_grad[c, y, i] *= np.float32(unclipped[c, y, i])


@jit_inlined
def detail_work_of(detail, codes_work, image):
    """Return the DetailWork of an image; codes_work: from `codes.workspace`."""
    f, w = filtering.filter_of(detail, image, False), detail.size[1]
    developed = np.empty((3, filtering.rows_at_once(f), w), np.float32)
    return DetailWork(f, codes_work, developed, np.empty((3, w), np.float32))


@jit_in_place
def develop_detail_rows(out, unclipped, raw, codes, detail, work, top, bottom):
    """Do the same as `develop.develop_rows`.

    Args:
        unclipped: (1, 3, ...) uint8, filled for `develop_detail_rows_back` with 1 where the clip
            leaves the code of a sensor pixel as it is, else 0; (0, 3, ...) if not needed.
        codes, detail: see `development_records`. work: from `detail_work_of`.
    """
    f, developed, step, line = work.filter, work.developed, work.codes.step, work.codes.resized
    develop.clear(out, top, bottom)
    first, last = develop.source_rows(detail.rows, top, bottom)
    entered = filtering.first_source_row(f, first) // step * step
    for start in range(first, last, filtering.BLOCK_ROWS):
        end = min(start + filtering.BLOCK_ROWS, last)
        while entered < filtering.rows_needed(f, end - 1):
            r, slot = entered % step, entered % developed.shape[1]
            if r == 0:
                codes_of_row(work.codes, raw, entered // step, codes)
            for c in range(3):
                develop.resize_along_row(developed[c, slot], work.codes, r, c, codes.cols)
            filtering.enter(f, developed, entered)
            entered += 1
        filtering.blur_block(f, start)
        for y in range(start, end):
            filtering.filter_row(work.filtered, developed, y, y - start, f)
            if len(unclipped):
                _fill_unclipped(unclipped[0], work.filtered, y)
            _resize_row(out, work.filtered, y, line, detail.rows, detail.cols, top, bottom)
    develop.clip(out, top, bottom)


@jit_in_place
def develop_detail_rows_back(codes_grad, grad, unclipped, detail, f, row, line):
    """Fill codes_grad (3, h, w) with the gradient in the codes of every sensor pixel, from grad
    (3, H, W) and what `develop_detail_rows` filled `unclipped` with, (3, h, w).

    f: the filter's transpose. row: (3, w) and line: (W,) float32, workspace.
    """
    h = codes_grad.shape[1]
    for y in range(h):
        _resize_row_back(codes_grad, unclipped, grad, y, line, detail.rows, detail.cols)
    # in place: a row is written after the last row that is made from it has entered the ring
    entered = 0
    for start in range(0, h, filtering.BLOCK_ROWS):
        end = min(start + filtering.BLOCK_ROWS, h)
        while entered < filtering.rows_needed(f, end - 1):
            filtering.enter(f, codes_grad, entered)
            entered += 1
        filtering.blur_block(f, start)
        for y in range(start, end):
            filtering.filter_row(row, codes_grad, y, y - start, f)
            for c in range(3):
                copy(codes_grad[c, y], row[c])


@jit_inlined
def _image_to_photo(registration, i):
    """Return the ImageToPhoto of image i."""
    k1, k2 = registration.distortion[i]
    return register.image_to_photo(registration.forward[i], k1, k2)


def in_camera_length(d) -> int:
    """Return how many values `develop_kernel` needs for a photo in the camera's frame."""
    return register.flat_length(*d.size) if d.registers else 0


@jit_inlined
def _fill_photo(out, raw, d, i, top, bottom):
    """Fill rows `top` to `bottom` of photo i from its raw."""
    h, w = d.size
    photo, in_camera = out.photos[i], out.photos[i]
    highest, lowest = top, bottom
    if d.registers:
        to_photo = _image_to_photo(d.registration, i)
        in_camera = out.in_camera[: 3 * h * w].reshape(3, h, w)
        highest, lowest = register.rows_read(to_photo, h, w, top, bottom)
    work = workspace(d.codes, i, raw.shape[2], w)
    if d.filters_detail:
        unclipped, detail_work = out.unclipped[i : i + 1], detail_work_of(d.detail, work, i)
        given = detail_work, highest, lowest
        develop_detail_rows(in_camera, unclipped, raw, d.codes, d.detail, *given)
    else:
        develop.develop_rows(in_camera, raw, d.codes, work, highest, lowest)
    if d.registers:
        register.register(photo, out.in_camera, to_photo, top, bottom)


@kernel
def develop_kernel(out, raw, d, first, last, top, bottom):
    """Fill rows `top` to `bottom` of the photos from `first` to `last` from raw (B, planes, h, w)
    float32; out: see `records.Photos`, d: from `develop_arrays`."""
    for i in range(first, last):
        _fill_photo(out, raw[i], d, i, top, bottom)


@jit_inlined
def _fill_raw_grad(raw_grad, grad, in_camera, unclipped, raw, d, i):
    """Fill raw_grad with the gradient in image i's raw, from that in its photo."""
    h, w = d.size
    if d.registers:
        fill(in_camera, ZERO)
        register.register_back(in_camera, grad, _image_to_photo(d.registration, i))
        grad = in_camera[: 3 * h * w].reshape(3, h, w)
    if d.filters_detail:
        h, w = d.detail.size
        codes_grad = np.empty((3, h, w), np.float32)
        f, row = filtering.filter_of(d.detail, i, True), np.empty((3, w), np.float32)
        line = np.empty(grad.shape[2], np.float32)
        develop_detail_rows_back(codes_grad, grad, unclipped[i], d.detail, f, row, line)
        grad = codes_grad
    work = workspace(d.codes, i, raw.shape[2], grad.shape[2])
    develop.develop_rows_back(raw_grad, grad, raw, d.codes, work, develop.gradients_of(work))


@kernel
def develop_back_kernel(raw_grad, photo_grad, in_camera, unclipped, raw, d, first, last):
    """Fill the gradients from `first` to `last` in raw, of raw's shape, from those in the photos.

    Args:
        in_camera: (`in_camera_length`(d),) float32, workspace. unclipped: what `develop_kernel`
            filled. d: as in `develop_kernel`.
    """
    for i in range(first, last):
        _fill_raw_grad(raw_grad[i], photo_grad[i], in_camera, unclipped, raw[i], d, i)
