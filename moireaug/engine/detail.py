"""The filters of a photo's codes, a row at a time: smooth colour and sharpen brightness; and their
transpose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.effects.detail import SMALLEST
from moireaug.engine.compiling import copy, fill, inner, loop
from moireaug.engine.development_records import LANES
from moireaug.engine.vectors import add_taps

FARTHEST = 4.5  # standard deviations: what lies beyond weighs less than 1e-5
ZERO, THIRD = np.float32(0), np.float32(1 / 3)


class _Filter(NamedTuple):
    """A linear filter of photos, and the rows that it works on.

    Args:
        chroma, sharp: the Gaussians of colour and of the unsharp mask, from `_gaussian`.
        amount: float32, strength of the mask. back: whether this is the filter's transpose.
        padded: (3, lanes + ends) float32, a row's red, blue and brightness, padded at both ends.
            full: a blurred row with its padding.
        ring: (3, rows, lanes) float32, horizontally blurred rows. place: (h,), where each row
            begins in a plane of the ring.
        soft: (3, lanes) float32, one row blurred both ways.
        steps: 0, 1, 2, ... int64. weight, offset: (rows,), the ring's rows that a row is made from.
    """

    chroma: np.ndarray
    sharp: np.ndarray
    amount: np.float32
    back: bool
    padded: np.ndarray
    full: np.ndarray
    ring: np.ndarray
    place: np.ndarray
    soft: np.ndarray
    steps: np.ndarray
    weight: np.ndarray
    offset: np.ndarray


@loop
def _gaussian(sigma, size):
    """Return a Gaussian's weights, float32, which sum to 1: `size`, which is odd, or fewer if the
    outermost are negligible."""
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
def filter_of(detail, image, back):
    """Return the _Filter of one image's Detail, or its transpose."""
    h, w = detail.size
    chroma = _gaussian(detail.chroma[image], detail.chroma_size)
    amount = detail.amount[image]
    # a single 1 where nothing is sharpened
    sharp = _gaussian(detail.sharp[image], detail.sharp_size if amount != 0 else 1)
    rows, lanes = max(len(chroma), len(sharp)), (w + LANES - 1) // LANES * LANES
    steps, place = np.empty(rows, np.int64), np.empty(h, np.int64)
    for k in range(rows):
        steps[k] = k
    for y in range(h):
        place[y] = y % rows * lanes
    return _Filter(
        chroma,
        sharp,
        amount,
        back,
        np.zeros((3, lanes + 2 * rows + LANES), np.float32),
        np.zeros(lanes + rows + LANES, np.float32),
        np.zeros((3, rows, lanes), np.float32),
        place,
        np.zeros((3, lanes), np.float32),
        steps,
        np.empty(rows, np.float32),
        np.empty(rows, np.int64),
    )


@inner
def _split(red, blue, grey, photo, y):
    """Take row y of a photo apart: red and blue less the brightness, and the brightness."""
    y %= photo.shape[1]
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    for i in range(len(r)):
        mean = (r[i] + g[i] + b[i]) * THIRD
        red[i] = r[i] - mean
        blue[i] = b[i] - mean
        grey[i] = mean


@inner
def _along(out, padded, kernel, f, w):
    """Fill out (lanes,) with a blurred row of w pixels, padded with its end pixels; the row begins
    half a kernel into `padded`."""
    half = len(kernel) // 2
    first, last = padded[half], padded[half + w - 1]
    for i in range(half):
        padded[i], padded[half + w + i] = first, last
    fill(out, ZERO)
    add_taps(out, 0, len(out), kernel, 0, len(kernel), padded, f.steps, 0)


@inner
def _along_back(out, padded, kernel, f, w):
    """Apply the transpose of `_along`: what falls into the padding is added to the end pixels. The
    row begins a whole kernel, less one, into `padded`, which is 0 elsewhere."""
    size, half = len(kernel), len(kernel) // 2
    lanes = (w + size - 1 + LANES - 1) // LANES * LANES
    fill(f.full, ZERO)
    add_taps(f.full, 0, lanes, kernel, 0, size, padded, f.steps, 0)
    copy(out[:w], f.full[half : half + w])
    for i in range(half):
        out[0] += f.full[i]
        out[w - 1] += f.full[half + w + i]


@inner
def enter(f, photo, y):
    """Blur row y of a photo horizontally, into the ring. The photo may hold its last rows only:
    row y at y modulo their number."""
    w = photo.shape[2]
    # the transpose reads a row half a kernel further on
    halves = 2 if f.back else 1
    colour, grey = len(f.chroma) // 2 * halves, len(f.sharp) // 2 * halves
    padded = f.padded
    _split(
        padded[0, colour : colour + w],
        padded[1, colour : colour + w],
        padded[2, grey : grey + w],
        photo,
        y,
    )
    row = y % f.ring.shape[1]
    for c in range(3):
        kernel = f.sharp if c == 2 else f.chroma
        if f.back:
            _along_back(f.ring[c, row], padded[c], kernel, f, w)
        else:
            _along(f.ring[c, row], padded[c], kernel, f, w)


@inner
def _rows_of(f, kernel, y):
    """Fill weight and offset with the ring's rows that row y is made from."""
    size, half, h = len(kernel), len(kernel) // 2, len(f.place)
    for k in range(size):
        f.offset[k] = f.place[min(max(y + k - half, 0), h - 1)]
        f.weight[k] = kernel[k]
    if f.back:
        _rows_back(f.weight, kernel, y, h)


@inner
def _rows_back(weight, kernel, y, h):
    """Turn the weights of row y of h into the transpose's: none of a row past the ends, and in the
    outermost rows those of the padding, too."""
    size, half = len(kernel), len(kernel) // 2
    before = after = ZERO
    for k in range(size):
        last = size - 1 - k
        if y == h - 1:
            weight[k] += before
        if y == 0:
            weight[last] += after
        before += kernel[k]
        after += kernel[last]
    for k in range(size):
        if not 0 <= y + k - half < h:
            weight[k] = ZERO


@inner
def _join(out, photo, y, soft, amount):
    """Fill out (3, w) with row y of a photo, its colours smoothed, and its brightness sharpened by
    its difference from the blurred one."""
    y %= photo.shape[1]
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    red, green, blue = out[0], out[1], out[2]
    soft_red, soft_blue, soft_grey = soft[0], soft[1], soft[2]
    for i in range(len(r)):
        grey = (r[i] + g[i] + b[i]) * THIRD
        sharp = grey + amount * (grey - soft_grey[i])
        red[i] = sharp + soft_red[i]
        blue[i] = sharp + soft_blue[i]
        green[i] = sharp - soft_red[i] - soft_blue[i]


@inner
def above(f, y):
    """Return the first row that row y is made from."""
    return max(y - f.ring.shape[1] // 2, 0)


@inner
def needed(f, y):
    """Return how many rows must have entered the ring before row y is filtered."""
    return min(y + f.ring.shape[1] // 2 + 1, len(f.place))


@inner
def filter_row(out, photo, y, f):
    """Fill out (3, w) with row y of a photo, filtered; arguments as in `enter`."""
    for c in range(3):
        if c != 1:  # red and blue are made from the same rows
            kernel = f.sharp if c == 2 else f.chroma
            _rows_of(f, kernel, y)
        fill(f.soft[c], ZERO)
        ring = f.ring[c].reshape(-1)
        add_taps(f.soft[c], 0, f.soft.shape[1], f.weight, 0, len(kernel), ring, f.offset, 0)
    _join(out, photo, y, f.soft, f.amount)
