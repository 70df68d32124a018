"""From the codes of every sensor pixel to a photo, one image a call, a row at a time: colour
smoothed, brightness sharpened, overshoots clipped, and resized; and the gradient's way back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.engine.compiling import copy, fill, inner, loop
from moireaug.engine.develop import gather
from moireaug.engine.record import LANES
from moireaug.engine.vectors import add, add_taps

SMALLEST = 1e-3  # standard deviation, as in the reference
FARTHEST = 4.5  # standard deviations: what lies beyond weighs less than 1e-5
ZERO, ONE, THIRD = np.float32(0), np.float32(1), np.float32(1 / 3)


class _Filter(NamedTuple):
    """A linear filter of photos, and the rows that it works on.

    Args:
        chroma, sharp: the Gaussians of colour and of the unsharp mask, from `gaussian`.
        amount: float32, of the mask. back: it is the filter's transpose.
        ring: (3, rows, lanes) float32, red, blue and brightness blurred along the rows: row y is
            at y % rows.
        colours, soft: (3, lanes) float32, of one row: before it is blurred, and after.
        padded, full: a row with what lies beyond its ends, and blurred with it.
        steps: 0, 1, 2, ... int64. weight, offset: (rows,), the ring's rows that a row is made from.
    """

    chroma: np.ndarray
    sharp: np.ndarray
    amount: np.float32
    back: bool
    ring: np.ndarray
    colours: np.ndarray
    soft: np.ndarray
    padded: np.ndarray
    full: np.ndarray
    steps: np.ndarray
    weight: np.ndarray
    offset: np.ndarray


@loop
def gaussian(sigma, size):
    """Return a Gaussian's weights, float32, that sum to 1: `size`, which is odd, or fewer where the
    outermost do not matter."""
    sigma = max(sigma, SMALLEST)
    half = min(size // 2, math.ceil(FARTHEST * sigma))
    weights, total = np.empty(2 * half + 1, np.float64), 0.0
    for k in range(len(weights)):
        weights[k] = math.exp(-((k - half) ** 2) / (2 * sigma * sigma))
        total += weights[k]
    out = np.empty(len(weights), np.float32)
    for k in range(len(weights)):
        out[k] = weights[k] / total
    return out


@loop
def _filter(w, chroma, amount, sharp, back):
    """Return the _Filter of photos of width w."""
    rows, lanes = max(len(chroma), len(sharp)), (w + LANES - 1) // LANES * LANES
    steps = np.empty(rows, np.int64)
    for k in range(rows):
        steps[k] = k
    return _Filter(
        chroma,
        sharp,
        amount,
        back,
        np.zeros((3, rows, lanes), np.float32),
        np.zeros((3, lanes), np.float32),
        np.zeros((3, lanes), np.float32),
        np.zeros(lanes + 2 * rows + LANES, np.float32),
        np.zeros(lanes + rows + LANES, np.float32),
        steps,
        np.empty(rows, np.float32),
        np.empty(rows, np.int64),
    )


@inner
def _along(out, row, kernel, f, w):
    """Fill out (lanes,) with a row (w,) blurred, its ends going on past it."""
    half, lanes = len(kernel) // 2, len(out)
    copy(f.padded[half : half + w], row)
    for i in range(half):
        f.padded[i], f.padded[half + w + i] = row[0], row[w - 1]
    fill(out, ZERO)
    add_taps(out, 0, lanes, kernel, 0, len(kernel), f.padded, f.steps, 0)


@inner
def _along_back(out, row, kernel, f, w):
    """Do the transpose of `_along`: what a row gave to what lies past its ends comes back."""
    size, half = len(kernel), len(kernel) // 2
    lanes = (w + size - 1 + LANES - 1) // LANES * LANES
    fill(f.padded, ZERO)
    copy(f.padded[2 * half : 2 * half + w], row)
    fill(f.full, ZERO)
    add_taps(f.full, 0, lanes, kernel, 0, size, f.padded, f.steps, 0)
    copy(out[:w], f.full[half : half + w])
    for i in range(half):
        out[0] += f.full[i]
        out[w - 1] += f.full[half + w + i]


@inner
def _rows_of(f, kernel, y, h):
    """Fill weight and offset with the ring's rows that row y of h is made from."""
    size, half = len(kernel), len(kernel) // 2
    rows, lanes = f.ring.shape[1], f.ring.shape[2]
    for k in range(size):
        other = y + k - half
        inside = 0 <= other < h
        other = min(max(other, 0), h - 1)
        f.offset[k], f.weight[k] = other % rows * lanes, kernel[k]
        if not f.back:
            continue
        if not inside:
            f.weight[k] = ZERO
            continue
        # the outermost row gave to all that lies past it
        for beyond in range(size):
            if (y == 0 and beyond > k) or (y == h - 1 and beyond < k):
                f.weight[k] += kernel[beyond]


@inner
def _split(colours, photo, y):
    """Take a row of a photo apart: red and blue less the brightness, and the brightness."""
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    red, blue, grey = colours[0], colours[1], colours[2]
    for i in range(len(r)):
        mean = (r[i] + g[i] + b[i]) * THIRD
        red[i] = r[i] - mean
        blue[i] = b[i] - mean
        grey[i] = mean


@inner
def _join(out, grey, soft, amount):
    """Put a row (3, w) together again, its brightness sharpened by its difference to what is
    soft."""
    r, g, b = out[0], out[1], out[2]
    red, blue, mean = soft[0], soft[1], soft[2]
    for i in range(len(r)):
        sharp = grey[i] + amount * (grey[i] - mean[i])
        r[i] = sharp + red[i]
        b[i] = sharp + blue[i]
        g[i] = sharp - red[i] - blue[i]


@inner
def _filter_row(out, photo, y, entered, f):
    """Fill out (3, w) with row y of a photo (3, h, w), filtered; return how many of its rows have
    entered the ring, which are `entered` before."""
    _, h, w = photo.shape
    rows = f.ring.shape[1]
    while entered < min(y + rows // 2 + 1, h):
        _split(f.colours, photo, entered)
        for c in range(3):
            kernel = f.sharp if c == 2 else f.chroma
            if f.back:
                _along_back(f.ring[c, entered % rows], f.colours[c], kernel, f, w)
            else:
                _along(f.ring[c, entered % rows], f.colours[c], kernel, f, w)
        entered += 1
    for c in range(3):
        kernel = f.sharp if c == 2 else f.chroma
        _rows_of(f, kernel, y, h)
        fill(f.soft[c], ZERO)
        ring = f.ring[c].reshape(-1)
        add_taps(f.soft[c], 0, f.soft.shape[1], f.weight, 0, len(kernel), ring, f.offset, 0)
    _split(f.colours, photo, y)
    _join(out, f.colours[2], f.soft, f.amount)
    return entered


@inner
def _resize_row(out, row, y, line, rows, cols):
    """Add a photo's row y (3, w), clipped, to out (3, H, W); line: (W,) to work in."""
    for c in range(3):
        for i in range(row.shape[1]):
            row[c, i] = min(max(row[c, i], ZERO), ONE)
        gather(line, row[c], cols.index, cols.weight)
        for i in range(rows.first[y], rows.last[y] + 1):
            add(out[c, i], line, rows.taps[i, y - rows.start[i]])


@inner
def _resize_row_back(row_grad, row, grad, y, line, rows, cols):
    """Fill row_grad (3, w) with the gradient in a photo's row y, of which `row` is what is to be
    clipped; arguments as in `_resize_row`."""
    for c in range(3):
        fill(line, ZERO)
        for i in range(rows.first[y], rows.last[y] + 1):
            add(line, grad[c, i], rows.taps[i, y - rows.start[i]])
        gather(row_grad[c], line, cols.back_index[0], cols.back_weight[0])
        for i in range(row.shape[1]):
            row_grad[c, i] *= ONE if ZERO <= row[c, i] <= ONE else ZERO


@loop
def finish(out, photo, chroma, amount, sharp, rows, cols):
    """Fill out (3, H, W) float32 from the codes (3, h, w) of every sensor pixel.

    Args:
        chroma, amount, sharp: see `_Filter`. rows, cols: see `record.Resize`.
    """
    _, h, w = photo.shape
    f = _filter(w, chroma, amount, sharp, False)
    row, line = np.empty((3, w), np.float32), np.empty(out.shape[2], np.float32)
    fill(out.reshape(-1), ZERO)
    entered = 0
    for y in range(h):
        entered = _filter_row(row, photo, y, entered, f)
        _resize_row(out, row, y, line, rows, cols)


@loop
def finish_back(photo_grad, grad, photo, chroma, amount, sharp, rows, cols):
    """Fill photo_grad (3, h, w) with the gradient in the codes, from grad (3, H, W); arguments as
    in `finish`."""
    _, h, w = photo.shape
    f = _filter(w, chroma, amount, sharp, False)
    row, row_grad = np.empty((3, w), np.float32), np.empty((3, w), np.float32)
    line = np.empty(grad.shape[2], np.float32)
    entered = 0
    for y in range(h):
        entered = _filter_row(row, photo, y, entered, f)
        _resize_row_back(row_grad, row, grad, y, line, rows, cols)
        for c in range(3):
            copy(photo_grad[c, y], row_grad[c])
    # in place: a row is written after the last row that is made from it has entered the ring
    f = _filter(w, chroma, amount, sharp, True)
    entered = 0
    for y in range(h):
        entered = _filter_row(row, photo_grad, y, entered, f)
        for c in range(3):
            copy(photo_grad[c, y], row[c])
