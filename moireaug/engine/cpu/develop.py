"""Raw to photo, one image per call, a cell row at a time: to codes, and resized."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu.codes import codes_of_row, is_read, workspace
from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
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
def _develop_rows(photo, raw, codes, work, top, bottom):
    """Do the same as `develop_image`, in buffers that it allocated."""
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


@jit_inlined
def develop_image(photo, raw, codes, image, top, bottom):
    """Fill rows `top` to `bottom` of photo (3, H, W) float32, codes in the camera's frame, from raw
    (4 or 3, h, w) float32.

    Args:
        codes: see `development_records.Codes`. image: index in the batch.
    """
    work = workspace(codes, image, raw.shape[2], photo.shape[2])
    _develop_rows(photo, raw, codes, work, top, bottom)
