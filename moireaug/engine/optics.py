"""What aperture and lens make of the panel: the cells that a pixel's light comes from, and the
harmonics it sees.

Both change slowly over a photo. They are computed on a grid of nodes and interpolated: the weights
linearly, the amplitudes by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import fill, inner, loop
from moireaug.engine.lookup import NARROW, WIDE
from moireaug.engine.tables import TAIL_END, add_integral, integral
from moireaug.engine.vectors import peek, poke
from moireaug.engine.view import jacobian
from moireaug.exposure.content import TAIL

NARROWEST = 1e-12  # variance in cells
GUARD = 1e-9
FEWEST_PHASES, MOST_PHASES = 64, 512
SMOOTH = 2e-3  # error of a weight that is interpolated linearly between phases
FAINT = 1e-3  # of a pixel's light: cells that give less are not looked at
STEPS, PER_CYCLE, MOST_STEPS = 512, 64, 2**16


@inner
def spreads(out, u, v, camera, period, width, skew, taps):
    """Fill out (axis, 2) with the box and the standard deviation of the light along both axes, in
    cells, at a photo point; narrowed to what 2 `taps` + 1 cells hold, as `exposure.content.fitted`
    does. Return whether any was narrowed."""
    narrowed = False
    xu, xv, yu, yv = jacobian(u, v, camera)
    beside = camera.blur * camera.blur + camera.olpf * camera.olpf / 4
    for axis in range(2):
        ju, jv = (abs(xu), abs(xv)) if axis == 0 else (abs(yu), abs(yv))
        ju, jv = ju / period[axis], jv / period[axis]
        moved = xu * camera.motion_x + xv * camera.motion_y
        if axis == 1:
            moved = yu * camera.motion_x + yv * camera.motion_y
        moved /= period[axis]
        short = min(ju, jv) * camera.fill
        out[axis, 0] = max(ju, jv) * camera.fill
        variance = short * short / 12 + (ju * ju + jv * jv) * beside + moved * moved + skew[axis]
        out[axis, 1] = math.sqrt(variance + NARROWEST)
        reach = out[axis, 0] / 2 + TAIL * out[axis, 1]
        shrink = min(1.0, max(taps + 0.5 - width[axis] / 2, NARROWEST) / reach)
        out[axis, 0] *= shrink
        out[axis, 1] *= shrink
        narrowed = narrowed or shrink < 1
    return narrowed


@inner
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


@inner
def _width(spread, widths, taps):
    """Return how many cells along an axis are looked at, over spreads (kinds * n, axis, 2): NARROW
    where none beyond matters."""
    n = len(spread) // len(widths)
    for i in range(len(spread)):
        for axis in range(2):
            box, sigma, width = spread[i, axis, 0], spread[i, axis, 1], widths[i // n, axis]
            if taps > 1 and _light(2.0, box, sigma, width) > FAINT * box * width:
                return WIDE
    return NARROW


@inner
def _light(x, box, sigma, width):
    """Return the light from a subpixel at distance x, of all light that a box of 1 would see."""
    far, near = (box + width) / 2, (box - width) / 2
    seen = integral(x + far, sigma) - integral(x + near, sigma)
    return max(seen - integral(x - near, sigma) + integral(x - far, sigma), 0.0)


@inner
def _add_two(total, light, middle):
    """Add the light of the cells `middle` before and behind."""
    for q in range(len(total)):
        total[q] += light[middle - q] + light[middle + q]


@inner
def _shares(out, box, sigma, width, taps, phases, light, total):
    """Fill out (phases + 2, cells) with the weights of the cells around, at distances from -1/2 to
    1/2 from the nearest cell's centre. Distance 0 is there twice, as the first of the cells changes
    there.

    light, total: workspaces of (2 taps + 1) phases / 2 + 1 and phases / 2 + 1 numbers.
    """
    half, cells = phases // 2, out.shape[1]
    seen = min(int(((box + width) / 2 + TAIL_END * sigma) * phases) + 2, len(light))
    fill(light, 0.0)
    far, near, line = (box + width) / 2, (box - width) / 2, light[:seen]
    add_integral(line, 1.0, far, 1 / phases, sigma)
    add_integral(line, -1.0, near, 1 / phases, sigma)
    add_integral(line, -1.0, -near, 1 / phases, sigma)
    add_integral(line, 1.0, -far, 1 / phases, sigma)
    for i in range(seen):
        light[i] = max(light[i], 0.0)  # rounding may leave it a digit below zero
    guard = GUARD * box
    for q in range(half + 1):
        total[q] = light[q] + guard
    for k in range(1, taps + 1):
        _add_two(total, light, k * phases)
    for q in range(half + 1):
        total[q] = 1 / total[q]
    for j in range(cells):
        k = j - cells // 2
        for q in range(half + 1):
            # a pixel q phases before the nearest cell's centre; as far behind, weights are mirrored
            at = abs(k) * phases + (q if k >= 0 else -q)
            share = np.float32(
                (light[at] + (guard if k == 0 else 0.0)) * total[q] if abs(k) <= taps else 0.0
            )
            out[half - q, j] = share
            out[half + 1 + q, cells - 1 - j] = share


@loop
def weights(us, vs, camera, period, taps, widths, skew):
    """Return the weights of cells on nodes of the photo: (kinds, rows, cols, axis, phases + 2,
    cells) float32.

    widths, skew: (kinds, 2), see `record.Exposure`.
    """
    kinds, rows, cols = len(widths), len(vs), len(us)
    spread = np.empty((kinds * rows * cols, 2, 2), np.float64)
    for i in range(len(spread)):
        kind = i // (rows * cols)
        spreads(
            spread[i],
            us[i % cols],
            vs[i // cols % rows],
            camera,
            period,
            widths[kind],
            skew[kind],
            taps,
        )
    phases = _phases(spread)
    out = np.empty((kinds, rows, cols, 2, phases + 2, _width(spread, widths, taps)), np.float32)
    light, total = (
        np.empty((2 * taps + 1) * phases // 2 + 1, np.float64),
        np.empty(phases // 2 + 1, np.float64),
    )
    for i in range(len(spread)):
        kind, r, c = i // (rows * cols), i // cols % rows, i % cols
        for axis in range(2):
            box, sigma = spread[i, axis, 0], spread[i, axis, 1]
            _shares(
                out[kind, r, c, axis], box, sigma, widths[kind, axis], taps, phases, light, total
            )
    return out


@inner
def blend(out, low, high, f):
    """Fill out (n,) with the values f of the way from one row of nodes to the next."""
    for i in range(len(out)):
        a = peek(low, i)
        poke(out, i, a + f * (peek(high, i) - a))


@loop
def _transfer_table(camera, most, steps):
    """Return the modulation transfer along one axis at steps + 2 frequencies in cycles per sensor
    pixel, from 0 to `most` and one step beyond."""
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


@inner
def _transfer(table, f):
    i = int(f)
    a, b, g = table[i], table[i + 1], f - i
    # the parabola through two neighbours and the mean curvature at both: the table holds an even,
    # smooth function
    before, after = table[abs(i - 1)], table[min(i + 2, len(table) - 1)]
    return a + g * (b - a) - g * (1 - g) / 4 * (before - a - b + after)


@loop
def amplitudes(us, vs, camera, period, coefficients):
    """Return (rows, cols, kinds, n, m) float32, each harmonic's amplitude on nodes of the photo.

    coefficients: (kinds, n, m) of harmonics k = 0 ... K and l = -L ... L, n = K + 1 and m = 2 L +
    1.
    """
    kinds, n, m = coefficients.shape
    half = m // 2
    moves = camera.motion_x != 0 or camera.motion_y != 0
    out = np.empty((len(vs), len(us), kinds, n, m), np.float32)
    views = np.empty((len(vs), len(us), 4), np.float64)
    most = 1e-9
    for r in range(len(vs)):
        for c in range(len(us)):
            xu, xv, yu, yv = jacobian(us[c], vs[r], camera)
            view = views[r, c]
            view[0], view[1], view[2], view[3] = (
                xu / period[0],
                yu / period[1],
                xv / period[0],
                yv / period[1],
            )
            most = max(
                most,
                (n - 1) * abs(view[0]) + half * abs(view[1]),
                (n - 1) * abs(view[2]) + half * abs(view[3]),
            )
    steps = min(max(STEPS, int(PER_CYCLE * most)), MOST_STEPS)
    table = _transfer_table(camera, most, steps)
    scale = steps / most
    for r in range(len(vs)):
        for c in range(len(us)):
            view = views[r, c]
            ux, uy, vx, vy = view[0], view[1], view[2], view[3]
            for k in range(n):
                for l in range(m):
                    fu, fv = k * ux + (l - half) * uy, k * vx + (l - half) * vy
                    passed = _transfer(table, abs(fu) * scale) * _transfer(table, abs(fv) * scale)
                    if moves:
                        along = fu * camera.motion_x + fv * camera.motion_y
                        passed *= math.exp(-2 * math.pi * math.pi * along * along)
                    for kind in range(kinds):
                        out[r, c, kind, k, l] = coefficients[kind, k, l] * passed
    return out
