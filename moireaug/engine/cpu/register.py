"""The photo brought back to the image's frame, and the backward pass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.common.physics.lens import MIN_RAY_DEPTH
from moireaug.engine.cpu.compiling import jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.vectors import load, store
from moireaug.engine.cpu.view import undistorted

UNDISTORTION_STEPS = 1024  # of a table
ONE = np.float32(1)
ONE32 = np.int32(1)
# rows of a _Row's arrays
X, Y = range(2)
SQUARE = WEIGHT = 2


def flat_length(h: int, w: int) -> int:
    """Return the length of a photo's flattened planes, with the values beyond them that a bilinear
    look-up at the last pixel reads with weight 0."""
    return 3 * h * w + w + 1


class ImageToPhoto(NamedTuple):
    """Where the pixels of an image's frame look on its photo.

    Args:
        forward: (3, 3) float64, homography from image coordinates about the centre to ideal photo
            coordinates about it.
        factor: (UNDISTORTION_STEPS + 2,) float64, takes ideal points to photo points, at squares of
            the ideal radius from 0 to that of the photo's corners. per_square: its steps per unit.
    """

    forward: np.ndarray
    factor: np.ndarray
    per_square: float


@jit
def image_to_photo(forward, k1, k2):
    """Return the ImageToPhoto of an image; k1, k2: of the lens."""
    edge, factor = (1 + k1 + k2) ** 2, np.ones(UNDISTORTION_STEPS + 2)
    if k1 != 0 or k2 != 0:
        for i in range(1, len(factor)):
            ideal = math.sqrt(i * edge / UNDISTORTION_STEPS)
            factor[i] = undistorted(ideal, k1, k2) / ideal
    return ImageToPhoto(forward, factor, UNDISTORTION_STEPS / edge)


class _Row(NamedTuple):
    """Where the pixels of a row look on the photo.

    Args:
        ideal: (3, w) float64, X and Y about the centre on a photo without distortion, and the
            SQUARE of the radius as a place in the table of an ImageToPhoto.
        at: (w,) int32, the upper left pixels that are looked at.
        share: (3, w) float32, fractions towards the lower right ones, along X and Y, and the
            WEIGHT: 1 inside the photo, 0 outside.
    """

    ideal: np.ndarray
    at: np.ndarray
    share: np.ndarray


@jit_inlined
def _row_of(w):
    """Return the _Row of a photo w wide."""
    return _Row(np.empty((3, w)), np.empty(w, np.int32), np.empty((3, w), np.float32))


@jit_in_place
def _fill_ideal(x, y, square, first, v, to_photo, radius_scale):
    """Fill x, y and square (w,), the `_Row`'s ideal, for a row v of an image, whose columns are
    `first` and those a pixel apart to the right of it; both about the centre. radius_scale: see
    `exposure_records.Camera`."""
    forward, per_square, last = to_photo.forward, to_photo.per_square, UNDISTORTION_STEPS + 0.5
    ax, bx = forward[0, 0], forward[0, 1] * v + forward[0, 2]
    ay, by = forward[1, 0], forward[1, 1] * v + forward[1, 2]
    az, bz = forward[2, 0], forward[2, 1] * v + forward[2, 2]
    for i in range(len(x)):
        u = i + first
        nearness = 1 / max(az * u + bz, MIN_RAY_DEPTH)
        right, below = (ax * u + bx) * nearness, (ay * u + by) * nearness
        store(x, i, right)
        store(y, i, below)
        store(square, i, min((right * right + below * below) * radius_scale * per_square, last))


@jit_in_place
def _factor_at(factor, square):
    """Return what an ImageToPhoto's factor is at a place in its table."""
    k = np.int32(square)
    low = load(factor, k)
    return low + (square - k) * (load(factor, np.int32(k + ONE32)) - low)


@jit_in_place
def fill_photo_positions(u, v, ideal, first, row, to_photo, camera):
    """Fill u and v (w,) with where a row of an image lies on the whole photo, about its centre;
    pixels that it does not show are put at its nearest edge.

    Args:
        ideal: (3, w) float64, workspace. to_photo: an ImageToPhoto. first, row: of the first pixel,
            see `_fill_ideal`.
    """
    half_h, half_w = camera.photo_height / 2, camera.photo_width / 2
    _fill_ideal(ideal[X], ideal[Y], ideal[SQUARE], first, row, to_photo, camera.radius_scale)
    for i in range(len(u)):
        lens_factor = _factor_at(to_photo.factor, load(ideal[SQUARE], i))
        store(u, i, min(max(load(ideal[X], i) * lens_factor, -half_w), half_w))
        store(v, i, min(max(load(ideal[Y], i) * lens_factor, -half_h), half_h))


@jit_in_place
def _distort(at, share, ideal, factor, h, w):
    """Fill `at` and share of a `_Row` from its `ideal`."""
    fx, fy, weight = share[X], share[Y], share[WEIGHT]
    half_w, half_h = w / 2, h / 2
    for i in range(len(at)):
        lens_factor = _factor_at(factor, load(ideal[SQUARE], i))
        x, y = load(ideal[X], i) * lens_factor, load(ideal[Y], i) * lens_factor
        inside = (abs(x) <= half_w) & (abs(y) <= half_h)
        x, y = min(max(x + half_w - 0.5, 0.0), w - 1.0), min(max(y + half_h - 0.5, 0.0), h - 1.0)
        left, top = np.int32(x), np.int32(y)
        store(at, i, np.int32(np.int32(top * np.int32(w)) + left))
        store(fx, i, x - left)
        store(fy, i, y - top)
        store(weight, i, 1.0 if inside else 0.0)


@jit_in_place
def _place(row, r, to_photo, h, w):
    """Fill the _Row with where row r of an image (h, w) looks."""
    ideal = row.ideal
    # in a loop without look-ups, which vectorises
    first, v, radius_scale = 0.5 - w / 2, r + 0.5 - h / 2, 4.0 / (h * h + w * w)
    _fill_ideal(ideal[X], ideal[Y], ideal[SQUARE], first, v, to_photo, radius_scale)
    _distort(row.at, row.share, ideal, to_photo.factor, h, w)


@jit_in_place
def _sample(out, photo, at, share, down):
    """Fill a row from a plane of the photo, whose rows lie `down` apart."""
    fx, fy, weight, right = share[X], share[Y], share[WEIGHT], ONE32
    for i in range(len(out)):
        k, f = load(at, i), load(fx, i)
        a, b = load(photo, k), load(photo, np.int32(k + right))
        k = np.int32(k + down)
        c, d = load(photo, k), load(photo, np.int32(k + right))
        above, below = a + f * (b - a), c + f * (d - c)
        store(out, i, load(weight, i) * (above + load(fy, i) * (below - above)))


@jit_in_place
def _scatter(photo, grad, at, share, down):
    """Add the gradient in a row to that in a plane of the photo."""
    fx, fy, weight = share[X], share[Y], share[WEIGHT]
    right, down = np.uint32(1), np.uint32(down)
    for i in range(len(grad)):
        # unsigned, so that numba does not look for indices from the end
        k, f, g = np.uint32(at[i]), fx[i], grad[i] * weight[i]
        below = g * fy[i]
        above = g - below
        photo[k] += above * (ONE - f)
        photo[k + right] += above * f
        photo[k + down] += below * (ONE - f)
        photo[k + down + right] += below * f


@jit_inlined
def rows_read(to_photo, h, w, top, bottom):
    """Return the first and one past the last row of a photo (3, h, w) that `register` reads for
    rows `top` to `bottom`."""
    if bottom - top == h:
        return 0, h
    row = _row_of(w)
    first, last = h, 0
    for r in range(top, bottom):
        _place(row, r, to_photo, h, w)
        for i in range(w):
            first, last = min(first, row.at[i] // w), max(last, row.at[i] // w)
    return first, min(last + 2, h)


@jit_inlined
def register(out, photo, to_photo, top, bottom):
    """Resample photo to rows `top` to `bottom` of out (3, H, W) float32: bilinear, black where the
    photo does not show the image.

    Args:
        photo: (`flat_length`(H, W),) float32, the planes one after another, and zeros.
        to_photo: an ImageToPhoto.
    """
    _, h, w = out.shape
    row = _row_of(w)
    for r in range(top, bottom):
        _place(row, r, to_photo, h, w)
        for c in range(3):
            _sample(out[c, r], photo[c * h * w :], row.at, row.share, np.int32(w))


@jit_inlined
def register_back(photo_grad, grad, to_photo):
    """Add the gradient in the photo to photo_grad, laid out as the photo of `register`, from grad
    (3, H, W), that in the registered one; arguments as in `register`."""
    _, h, w = grad.shape
    row = _row_of(w)
    for r in range(h):
        _place(row, r, to_photo, h, w)
        for c in range(3):
            _scatter(photo_grad[c * h * w :], grad[c, r], row.at, row.share, np.int32(w))
