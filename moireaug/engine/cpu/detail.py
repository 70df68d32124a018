"""The filter of a photo's codes, which smooths colour and sharpens brightness, and its transpose.
Rows are blurred one at a time horizontally, and then a block of them vertically."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.camera.effects.detail import MIN_SIGMA
from moireaug.engine.cpu.compiling import copy, fill, jit, jit_in_place, jit_in_place_inlined
from moireaug.engine.cpu.vectors import LANES, SUMS_AT_ONCE, add_four_sums, add_sum, padded_width

BLOCK_ROWS = SUMS_AT_ONCE  # rows that are blurred vertically at once
GAUSSIAN_REACH_SIGMAS = 4.5  # beyond it a Gaussian weighs less than 1e-5
ZERO, THIRD = np.float32(0), np.float32(1 / 3)


class Filter(NamedTuple):
    """A linear filter of photos, and the rows that it works on.

    Args:
        chroma, sharp: the Gaussians of colour and of the unsharp mask, from `_gaussian`.
        amount: float32, strength of the mask. back: whether this is the filter's transpose.
        reach: rows above and below that a row is made from.
        padded: (3, lanes + ends) float32, a row's red, blue and brightness, padded at both ends.
            full: (lanes + ends,) float32, a blurred row with its padding.
        ring: (3, rows * lanes) float32, horizontally blurred rows, as many as a block is made from.
            place: (h,) int64, where each row begins in a plane of the ring.
        soft: (3, BLOCK_ROWS, lanes) float32, a block blurred both ways.
        steps: (taps,) int64, 0, 1, 2, ... weight: (BLOCK_ROWS, rows) float32 and offset: (rows,)
            int64, of the ring's rows that those of a block are made from.
    """

    chroma: np.ndarray
    sharp: np.ndarray
    amount: np.float32
    back: bool
    reach: int
    padded: np.ndarray
    full: np.ndarray
    ring: np.ndarray
    place: np.ndarray
    soft: np.ndarray
    steps: np.ndarray
    weight: np.ndarray
    offset: np.ndarray


@jit
def _gaussian(sigma, size):
    """Return a Gaussian's weights, float32, which sum to 1: `size`, which is odd, or fewer if the
    outermost are negligible."""
    sigma = max(sigma, MIN_SIGMA)
    half = min(size // 2, math.ceil(GAUSSIAN_REACH_SIGMAS * sigma))
    weights, total = np.empty(2 * half + 1, np.float64), 0.0
    for k in range(len(weights)):
        weights[k] = math.exp(-((k - half) ** 2) / (2 * sigma * sigma))
        total += weights[k]
    out = np.empty(len(weights), np.float32)
    for k in range(len(weights)):
        out[k] = weights[k] / total
    return out


@jit
def filter_of(detail, image, back):
    """Return the Filter of one image's Detail, or its transpose."""
    h, w = detail.size
    chroma = _gaussian(detail.chroma[image], detail.chroma_size)
    amount = detail.amount[image]
    # a single 1 where nothing is sharpened
    sharp = _gaussian(detail.sharp[image], detail.sharp_size if amount != 0 else 1)
    size, lanes = max(len(chroma), len(sharp)), padded_width(w)
    rows = size + BLOCK_ROWS - 1
    steps, place = np.empty(size, np.int64), np.empty(h, np.int64)
    for k in range(size):
        steps[k] = k
    for y in range(h):
        place[y] = y % rows * lanes
    return Filter(
        chroma,
        sharp,
        amount,
        back,
        size // 2,
        np.zeros((3, lanes + 2 * size + LANES), np.float32),
        np.zeros(lanes + size + LANES, np.float32),
        np.zeros((3, rows * lanes), np.float32),
        place,
        np.zeros((3, BLOCK_ROWS, lanes), np.float32),
        steps,
        np.empty((BLOCK_ROWS, rows), np.float32),
        np.empty(rows, np.int64),
    )


@jit_in_place
def _split(red, blue, grey, photo, y):
    """Take row y of a photo apart: red and blue less the brightness, and the brightness."""
    y %= photo.shape[1]
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    for i in range(len(r)):
        mean = (r[i] + g[i] + b[i]) * THIRD
        red[i] = r[i] - mean
        blue[i] = b[i] - mean
        grey[i] = mean


@jit_in_place
def _blur_row(out, padded, kernel, f, w):
    """Fill out (lanes,) with a blurred row of w pixels, padded with its end pixels; the row begins
    half a kernel into `padded`."""
    half = len(kernel) // 2
    first, last = padded[half], padded[half + w - 1]
    for i in range(half):
        padded[i], padded[half + w + i] = first, last
    fill(out, ZERO)
    add_sum(out, kernel, padded, f.steps[: len(kernel)])


@jit_in_place
def _blur_row_back(out, padded, kernel, f, w):
    """Apply the transpose of `_blur_row`: what falls into the padding is added to the end pixels.
    The row begins a whole kernel, less one, into `padded`, which is 0 elsewhere."""
    size, half = len(kernel), len(kernel) // 2
    lanes = padded_width(w + size - 1)
    fill(f.full, ZERO)
    add_sum(f.full[:lanes], kernel, padded, f.steps[:size])
    copy(out[:w], f.full[half : half + w])
    first = out[0]
    for i in range(half):
        first += f.full[i]
    out[0] = first
    last = out[w - 1]
    for i in range(half):
        last += f.full[half + w + i]
    out[w - 1] = last


@jit_in_place_inlined
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
    start, lanes = f.place[y], f.soft.shape[2]
    for c in range(3):
        kernel, out = f.sharp if c == 2 else f.chroma, f.ring[c, start : start + lanes]
        if f.back:
            _blur_row_back(out, padded[c], kernel, f, w)
        else:
            _blur_row(out, padded[c], kernel, f, w)


@jit_in_place
def _fill_block_sources(f, kernel, y):
    """Fill the Filter's weight and offset for the BLOCK_ROWS rows from y on; those past the last
    row are not used."""
    size, half, h = len(kernel), len(kernel) // 2, len(f.place)
    for k in range(size + BLOCK_ROWS - 1):
        f.offset[k] = f.place[min(max(y + k - half, 0), h - 1)]
    fill(f.weight.reshape(-1), ZERO)
    for i in range(BLOCK_ROWS):
        weight = f.weight[i, i : i + size]
        copy(weight, kernel)
        if f.back:
            _transpose_sources(weight, kernel, y + i, h)


@jit_in_place
def _transpose_sources(weight, kernel, y, h):
    """Turn the weights of row y of h into the transpose's: 0 for rows past the ends, and in the
    outermost rows with those of the padding added."""
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


@jit_in_place
def first_source_row(f, y):
    """Return the first row that row y is made from."""
    return max(y - f.reach, 0)


@jit_in_place
def rows_needed(f, y):
    """Return how many rows must have entered the ring before row y is blurred vertically."""
    return min(y + f.reach + 1, len(f.place))


@jit_in_place
def rows_at_once(f):
    """Return how many rows of a photo `enter` and `filter_row` need at once."""
    return min(f.reach + BLOCK_ROWS, len(f.place))


@jit_in_place_inlined
def blur_block(f, y):
    """Blur the BLOCK_ROWS rows from y on vertically."""
    for c in range(3):
        kernel = f.sharp if c == 2 else f.chroma
        if c != 1:  # red and blue are made from the same rows
            _fill_block_sources(f, kernel, y)
        soft, weight = f.soft[c].reshape(-1), f.weight.reshape(-1)
        fill(soft, ZERO)
        add_four_sums(soft, weight, f.ring[c], f.offset[: len(kernel) + BLOCK_ROWS - 1])


@jit_in_place_inlined
def filter_row(out, photo, y, k, f):
    """Fill out (3, w) with row y of a photo, row k of the block that `blur_block` blurred: its
    colours smoothed, and its brightness sharpened by its difference from the blurred one. photo: as
    in `enter`."""
    y %= photo.shape[1]
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    red, green, blue = out[0], out[1], out[2]
    soft_red, soft_blue, soft_grey = f.soft[0, k], f.soft[1, k], f.soft[2, k]
    for i in range(len(r)):
        grey = (r[i] + g[i] + b[i]) * THIRD
        sharp = grey + f.amount * (grey - soft_grey[i])
        red[i] = sharp + soft_red[i]
        blue[i] = sharp + soft_blue[i]
        green[i] = sharp - soft_red[i] - soft_blue[i]
