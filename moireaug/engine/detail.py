"""From the codes of every sensor pixel to a photo, one image a call: colour smoothed, brightness
sharpened, overshoots clipped, and resized; and the gradient's way back."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import fill, inner, loop

SMALLEST = 1e-3  # standard deviation, as in the reference
ZERO, ONE, THIRD = np.float32(0), np.float32(1), np.float32(1 / 3)


@loop
def gaussian(sigma, size):
    """Return a Gaussian's weights, (size,) float32, size odd, that sum to 1."""
    sigma, half = max(sigma, SMALLEST), size // 2
    weights, total = np.empty(size, np.float64), 0.0
    for k in range(size):
        weights[k] = math.exp(-((k - half) ** 2) / (2 * sigma * sigma))
        total += weights[k]
    out = np.empty(size, np.float32)
    for k in range(size):
        out[k] = weights[k] / total
    return out


@inner
def _add(out, row, weight):
    for i in range(len(out)):
        out[i] += weight * row[i]


@inner
def _along(out, row, padded, weights):
    """Fill out (w,) with a row (w,) blurred, its ends going on past it; padded: to work in."""
    w, half = len(row), len(weights) // 2
    for i in range(w):
        padded[half + i] = row[i]
    for i in range(half):
        padded[i], padded[half + w + i] = row[0], row[w - 1]
    fill(out, ZERO)
    for k in range(len(weights)):
        _add(out, padded[k : k + w], weights[k])


@inner
def _along_back(out, row, padded, weights):
    """Do the transpose of `_along`."""
    w, half = len(row), len(weights) // 2
    fill(padded, ZERO)
    for k in range(len(weights)):
        _add(padded[k : k + w], row, weights[k])
    for i in range(half):
        padded[half] += padded[i]
        padded[half + w - 1] += padded[half + w + i]
    for i in range(w):
        out[i] = padded[half + i]


@loop
def _blur(out, plane, weights, work, back):
    """Fill out (h, w) with a plane blurred along both axes, or with the transpose of that; work:
    (h, w)."""
    h, w = plane.shape
    half = len(weights) // 2
    padded = np.empty(w + 2 * half, np.float32)
    for y in range(h):
        if back:
            _along_back(work[y], plane[y], padded, weights)
        else:
            _along(work[y], plane[y], padded, weights)
        fill(out[y], ZERO)
    for y in range(h):
        for k in range(len(weights)):
            other = min(max(y + k - half, 0), h - 1)
            if back:
                _add(out[other], work[y], weights[k])
            else:
                _add(out[y], work[other], weights[k])


@inner
def _split(red, blue, grey, photo, y):
    """Take a row of a photo apart: red and blue less the brightness, and the brightness."""
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    for i in range(len(grey)):
        mean = (r[i] + g[i] + b[i]) * THIRD
        red[i] = r[i] - mean
        blue[i] = b[i] - mean
        grey[i] = mean


@inner
def _join(photo, y, red, blue, grey, soft, amount):
    """Put a row together again, its brightness sharpened by its difference to `soft`."""
    r, g, b = photo[0, y], photo[1, y], photo[2, y]
    for i in range(len(grey)):
        sharp = grey[i] + amount * (grey[i] - soft[i])
        r[i] = sharp + red[i]
        b[i] = sharp + blue[i]
        g[i] = sharp - red[i] - blue[i]


@loop
def _resize(out, photo, rows, cols):
    """Fill out (3, H, W) with a photo (3, h, w) resized."""
    _, h, w = photo.shape
    line = np.empty(out.shape[2], np.float32)
    for c in range(3):
        fill(out[c].reshape(-1), ZERO)
        for y in range(h):
            if rows.first[y] > rows.last[y]:
                continue
            for i in range(len(line)):
                total = ZERO
                for t in range(cols.taps.shape[1]):
                    total += cols.taps[i, t] * photo[c, y, min(cols.start[i] + t, w - 1)]
                line[i] = total
            for i in range(rows.first[y], rows.last[y] + 1):
                _add(out[c, i], line, rows.taps[i, y - rows.start[i]])


@loop
def _resize_back(photo_grad, grad, rows, cols):
    """Do the transpose of `_resize`."""
    _, h, w = photo_grad.shape
    line = np.empty(grad.shape[2], np.float32)
    for c in range(3):
        for y in range(h):
            fill(line, ZERO)
            for i in range(rows.first[y], rows.last[y] + 1):
                _add(line, grad[c, i], rows.taps[i, y - rows.start[i]])
            fill(photo_grad[c, y], ZERO)
            for i in range(len(line)):
                for t in range(cols.taps.shape[1]):
                    photo_grad[c, y, min(cols.start[i] + t, w - 1)] += cols.taps[i, t] * line[i]


@loop
def finish(out, photo, chroma, amount, sharp, rows, cols):
    """Fill out (3, H, W) float32 from the codes (3, h, w) of every sensor pixel.

    Args:
        chroma, amount, sharp: see `_filter`. rows, cols: see `record.Resize`.
    """
    whole = np.empty(photo.shape, np.float32)
    _filter(whole, photo, chroma, amount, sharp, False)
    flat = whole.reshape(-1)
    for i in range(len(flat)):
        flat[i] = min(max(flat[i], ZERO), ONE)
    _resize(out, whole, rows, cols)


@loop
def finish_back(photo_grad, grad, photo, chroma, amount, sharp, rows, cols):
    """Fill photo_grad (3, h, w) with the gradient in the codes, from grad (3, H, W); arguments as
    in `finish`."""
    whole, slope = np.empty(photo.shape, np.float32), np.empty(photo.shape, np.float32)
    _filter(whole, photo, chroma, amount, sharp, False)
    _resize_back(slope, grad, rows, cols)
    values, slopes = whole.reshape(-1), slope.reshape(-1)
    for i in range(len(values)):
        slopes[i] = slopes[i] if ZERO <= values[i] <= ONE else ZERO
    _filter(photo_grad, slope, chroma, amount, sharp, True)


@loop
def _filter(out, photo, chroma, amount, sharp, back):
    """Fill out (3, h, w) float32 from a photo of that shape, unclipped: linear.

    Args:
        chroma, sharp: weights of the Gaussians of colour and of the unsharp mask, from `gaussian`.
        amount: float32, of the mask. back: do the transpose instead.
    """
    _, h, w = photo.shape
    planes, soft = np.empty((3, h, w), np.float32), np.empty((3, h, w), np.float32)
    work = np.empty((h, w), np.float32)
    for y in range(h):
        _split(planes[0, y], planes[1, y], planes[2, y], photo, y)
    if len(chroma) > 1:
        _blur(soft[0], planes[0], chroma, work, back)
        _blur(soft[1], planes[1], chroma, work, back)
    else:
        soft[0], soft[1] = planes[0], planes[1]
    if amount != 0:
        _blur(soft[2], planes[2], sharp, work, back)
    else:
        soft[2] = planes[2]
    for y in range(h):
        _join(out, y, soft[0, y], soft[1, y], planes[2, y], soft[2, y], amount)
