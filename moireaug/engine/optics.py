"""What aperture and lens make of the panel: the cells that a pixel's light comes from, and the harmonics it sees.

Both change slowly over a photo. They are computed on a grid of nodes and interpolated: the weights linearly, the
amplitudes by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import loop
from moireaug.engine.tables import integral
from moireaug.engine.vectors import peek, poke
from moireaug.engine.view import jacobian
from moireaug.exposure.content import TAIL

NARROWEST = 1e-12  # variance in cells
GUARD = 1e-9
PACKED = 65535.0
FEWEST_PHASES, MOST_PHASES = 64, 512
SMOOTH = 2e-3  # how well straight lines between phases follow a weight
FAINT = 1e-5  # of a pixel's light: what cells must give to be looked at
STEPS, PER_CYCLE, MOST_STEPS = 512, 64, 2**16


@loop
def spreads(out, u, v, camera, period, width, skew, taps):
    """Fill out (axis, 2) with the box and the standard deviation of the light along both axes, in cells, at a photo
    point; narrowed to what 2 `taps` + 1 cells hold, as `exposure.content.fitted` does. Return whether any was."""
    narrowed = False
    xu, xv, yu, yv = jacobian(u, v, camera)
    beside = camera.blur * camera.blur + camera.olpf * camera.olpf / 4
    for axis in range(2):
        ju, jv = (abs(xu), abs(xv)) if axis == 0 else (abs(yu), abs(yv))
        ju, jv = ju / period[axis], jv / period[axis]
        short = min(ju, jv) * camera.fill
        out[axis, 0] = max(ju, jv) * camera.fill
        variance = short * short / 12 + (ju * ju + jv * jv) * beside + skew[axis]
        out[axis, 1] = math.sqrt(variance + NARROWEST)
        reach = out[axis, 0] / 2 + TAIL * out[axis, 1]
        shrink = min(1.0, (taps + 0.5 - width[axis] / 2) / reach)
        out[axis, 0] *= shrink
        out[axis, 1] *= shrink
        narrowed = narrowed or shrink < 1
    return narrowed


@loop
def _phases(spread):
    """Return how many phases tables of weights need, over spreads (n, axis, 2)."""
    needed = 1.0
    for i in range(len(spread)):
        for axis in range(2):
            needed = max(needed, 1 / math.sqrt(SMOOTH * spread[i, axis, 0] * spread[i, axis, 1]))
    phases = FEWEST_PHASES
    while phases < min(needed, MOST_PHASES):
        phases *= 2
    return phases


@loop
def _fewest(spread, widths, taps):
    """Return how many cells to each side matter, at most `taps`, over spreads (kinds * n, axis, 2)."""
    n = len(spread) // len(widths)
    while taps > 0:
        nearest = taps - 0.5  # that the farthest cell's centre comes
        for i in range(len(spread)):
            for axis in range(2):
                box, sigma, width = spread[i, axis, 0], spread[i, axis, 1], widths[i // n, axis]
                if _light(nearest, box, sigma, width) > FAINT * box * width:
                    return taps
        taps -= 1
    return taps


@loop
def _light(x, box, sigma, width):
    """Return the light from a subpixel at distance x, of all light that a box of 1 would see."""
    far, near = (box + width) / 2, (box - width) / 2
    seen = integral(x + far, sigma) - integral(x + near, sigma)
    return max(seen - integral(x - near, sigma) + integral(x - far, sigma), 0.0)


@loop
def _shares(out, start, box, sigma, width, taps, phases, light):
    """Fill out from `start` on with the weights of the cells -1, 1, -2, 2, ..., phases + 1 of each, at distances from
    -1/2 to 1/2 from a cell's centre. `light`, of (2 r + 1) phases / 2 + 1 numbers, to work in."""
    for i in range(len(light)):
        light[i] = _light(i / phases, box, sigma, width)
    n = phases + 1
    for p in range(n):
        at = p - phases // 2
        total = GUARD * box
        for k in range(-taps, taps + 1):
            total += light[abs(at - k * phases)]
        for j in range(taps):
            out[start + 2 * j * n + p] = light[abs(at + (j + 1) * phases)] / total
            out[start + (2 * j + 1) * n + p] = light[abs(at - (j + 1) * phases)] / total


@loop
def weights(us, vs, camera, period, taps, widths, skew):
    """Return tables (kinds, rows, cols * axis * 2 r * (phases + 1)) float32 of the weights of cells, on nodes of the
    photo, the number of phases, and r, at most `taps`.

    widths, skew: (kinds, 2), see `expose`.
    """
    kinds, rows, cols = len(widths), len(vs), len(us)
    spread = np.empty((kinds * rows * cols, 2, 2), np.float64)
    for i in range(len(spread)):
        kind = i // (rows * cols)
        spreads(spread[i], us[i % cols], vs[i // cols % rows], camera, period, widths[kind], skew[kind], taps)
    phases, taps = _phases(spread), _fewest(spread, widths, taps)
    size = 2 * taps * (phases + 1)
    out = np.empty((kinds, rows, cols * 2 * size), np.float32)
    light = np.empty((2 * taps + 1) * phases // 2 + 1, np.float64)
    for i in range(len(spread)):
        kind, r, c = i // (rows * cols), i // cols % rows, i % cols
        for axis in range(2):
            box, sigma = spread[i, axis, 0], spread[i, axis, 1]
            _shares(out[kind, r], (2 * c + axis) * size, box, sigma, widths[kind, axis], taps, phases, light)
    return out, phases, taps


@loop
def pack(packed, low, high, f, n):
    """Fill packed (m,) uint32 with two 16 bit weights each, f of the way between two nodes' tables (2 m,), which hold n
    weights of the cell before and then n of the cell after."""
    scale, sixteen = np.float32(PACKED), np.uint32(16)
    for start in range(0, len(packed), n):
        for p in range(start, start + n):
            i = p + start
            before, after = peek(low, i), peek(low, i + n)
            before += f * (peek(high, i) - before)
            after += f * (peek(high, i + n) - after)
            first, second = np.uint32(np.int32(before * scale)), np.uint32(np.int32(after * scale))
            poke(packed, p, np.uint32(first | np.uint32(second << sixteen)))


@loop
def _transfer_table(camera, most, steps):
    """Return the modulation transfer along one axis at steps + 2 frequencies from 0 to `most` cycles a sensor pixel."""
    out = np.empty(steps + 2, np.float64)
    for i in range(steps + 2):
        f = i * most / steps
        t = math.pi * camera.fill * f
        aperture = math.sin(t) / t if t > 1e-9 else 1.0
        out[i] = (
            aperture
            * math.exp(-2 * math.pi * math.pi * camera.blur * camera.blur * f * f)
            * math.cos(math.pi * camera.olpf * f)
        )
    return out


@loop
def _transfer(table, f):
    i = int(f)
    a, b, g = table[i], table[i + 1], f - i
    # the parabola through two neighbours and the mean curvature at both: the table holds an even, smooth function
    before, after = table[abs(i - 1)], table[min(i + 2, len(table) - 1)]
    return a + g * (b - a) - g * (1 - g) / 4 * (before - a - b + after)


@loop
def amplitudes(us, vs, camera, period, coefficients):
    """Return (rows, cols * kinds * n * m) float32, each harmonic's amplitude on nodes of the photo, n = K + 1 and
    m = 2 L + 1.

    coefficients: (kinds, K + 1, 2 L + 1), of harmonics k = 0 ... K and l = -L ... L.
    """
    kinds, n, m = coefficients.shape
    half = m // 2
    out = np.empty((len(vs), len(us) * kinds * n * m), np.float32)
    views = np.empty((len(vs), len(us), 4), np.float64)
    most = 1e-9
    for r in range(len(vs)):
        for c in range(len(us)):
            xu, xv, yu, yv = jacobian(us[c], vs[r], camera)
            view = views[r, c]
            view[0], view[1], view[2], view[3] = xu / period[0], yu / period[1], xv / period[0], yv / period[1]
            most = max(most, (n - 1) * abs(view[0]) + half * abs(view[1]), (n - 1) * abs(view[2]) + half * abs(view[3]))
    steps = min(max(STEPS, int(PER_CYCLE * most)), MOST_STEPS)
    table = _transfer_table(camera, most, steps)
    scale = steps / most
    for r in range(len(vs)):
        for c in range(len(us)):
            view = views[r, c]
            ux, uy, vx, vy = view[0], view[1], view[2], view[3]
            for k in range(n):
                for l in range(m):
                    fu, fv = abs(k * ux + (l - half) * uy), abs(k * vx + (l - half) * vy)
                    passed = _transfer(table, fu * scale) * _transfer(table, fv * scale)
                    for kind in range(kinds):
                        out[r, ((c * kinds + kind) * n + k) * m + l] = coefficients[kind, k, l] * passed
    return out, n, m
