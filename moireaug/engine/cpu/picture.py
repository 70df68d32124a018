"""The picture as light: decoded, and blurred as the prefilter does, a row at a time."""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu.compiling import jit, jit_in_place
from moireaug.engine.cpu.srgb import DECODE_BYTE_TABLE, decode, decode_slope

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)


@jit_in_place
def _decode_row(out, row, byte, coded, black):
    """Fill out (w + 2,) with the light of a row (w,) of the picture, its end values repeated."""
    w = len(row)
    if byte and coded:
        for i in range(w):
            out[i + 1] = DECODE_BYTE_TABLE[np.uint32(row[i])]
    elif byte:
        for i in range(w):
            out[i + 1] = np.float32(row[i]) * np.float32(1 / 255)
    elif coded:
        for i in range(w):
            out[i + 1] = decode(np.float32(row[i]))
    else:
        for i in range(w):
            out[i + 1] = row[i]
    if black != 0:
        for i in range(w):
            out[i + 1] += black * (ONE - out[i + 1])
    out[0], out[w + 1] = out[1], out[w]


@jit_in_place
def _blur(out, before, row, after, neighbour_share):
    """Fill out with a row of which `neighbour_share` comes in equal parts from its neighbours."""
    own, half = ONE - neighbour_share, HALF * neighbour_share
    for i in range(len(out)):
        out[i] = own * row[i] + half * (before[i] + after[i])


@jit
def fill_light(light, picture, coded, black, neighbour_share):
    """Fill light (3, H, W) float32 from picture (3, H, W) float32 or uint8.

    Args:
        coded: the picture holds sRGB codes.
        black: float32, light of a black pixel as a share of a white one's.
        neighbour_share: float32, share of a pixel's light that comes from its neighbours along each
            axis; see `prefilter.blur_by_neighbours`.
    """
    _, h, w = picture.shape
    byte = picture.itemsize == 1
    line, ring = np.empty(w + 2, np.float32), np.empty((3, w), np.float32)
    for c in range(3):
        if neighbour_share == 0:
            for y in range(h):
                _decode_row(line, picture[c, y], byte, coded, black)
                for i in range(w):
                    light[c, y, i] = line[i + 1]
            continue
        for y in range(h + 1):
            if y < h:
                _decode_row(line, picture[c, y], byte, coded, black)
                _blur(ring[y % 3], line[:w], line[1 : w + 1], line[2:], neighbour_share)
            if y > 0:
                above, below = max(y - 2, 0) % 3, min(y, h - 1) % 3
                row = ring[(y - 1) % 3]
                _blur(light[c, y - 1], ring[above], row, ring[below], neighbour_share)


@jit_in_place
def _multiply_by_slope(grad, row, coded, black):
    """Multiply a row (w,) of the gradient in the light by the slope of the light in the picture."""
    for i in range(len(grad)):
        slope = decode_slope(row[i]) if coded else ONE
        grad[i] *= slope * (ONE - black)


@jit
def fill_light_back(grad, light_grad, picture, coded, black, neighbour_share):
    """Fill grad (3, H, W) with the gradient in a float32 picture, from that in its light; the rest
    as in `fill_light`."""
    # the blur is its own transpose
    fill_light(grad, light_grad, False, ZERO, neighbour_share)
    for c in range(3):
        for y in range(grad.shape[1]):
            _multiply_by_slope(grad[c, y], picture[c, y], coded, black)
