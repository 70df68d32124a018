"""The harmonics that a sensor pixel sees of the panel, through its aperture and lens.

They change slowly over a photo: they are computed on a grid of nodes and interpolated by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import inner, loop
from moireaug.engine.view import jacobian

STEPS, PER_CYCLE, MOST_STEPS = 512, 64, 2**16


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
def amplitudes(us, vs, camera, cell, coefficients):
    """Return (rows, cols, kinds, n, m) float32, each harmonic's amplitude on nodes of the photo.

    coefficients: (kinds, n, m) of harmonics k = 0 ... K and l = -L ... L, n = K + 1 and m = 2 L +
    1.
    """
    kinds, n, m = coefficients.shape
    half = m // 2
    moves = camera.motion_x != 0 or camera.motion_y != 0
    out = np.zeros((len(vs), len(us), kinds, n, m), np.float32)
    views = np.empty((len(vs), len(us), kinds, 4), np.float64)  # cells per sensor pixel
    most = 1e-9
    for r in range(len(vs)):
        for c in range(len(us)):
            xu, xv, yu, yv = jacobian(us[c], vs[r], camera)
            for kind in range(kinds):
                (px, py), (k, l), view = cell.period[kind], cell.orders[kind], views[r, c, kind]
                view[0], view[1], view[2], view[3] = xu / px, yu / py, xv / px, yv / py
                most = max(
                    most,
                    k * abs(view[0]) + l * abs(view[1]),
                    k * abs(view[2]) + l * abs(view[3]),
                )
    steps = min(max(STEPS, int(PER_CYCLE * most)), MOST_STEPS)
    table = _transfer_table(camera, most, steps)
    scale = steps / most
    for i in range(len(vs) * len(us) * kinds):
        kind, c, r = i % kinds, i // kinds % len(us), i // kinds // len(us)
        ux, uy, vx, vy = views[r, c, kind]
        for k in range(n):
            for l in range(m):
                if coefficients[kind, k, l] == 0:
                    continue
                fu, fv = k * ux + (l - half) * uy, k * vx + (l - half) * vy
                passed = _transfer(table, abs(fu) * scale) * _transfer(table, abs(fv) * scale)
                if moves:
                    along = fu * camera.motion_x + fv * camera.motion_y
                    passed *= math.exp(-2 * math.pi * math.pi * along * along)
                out[r, c, kind, k, l] = coefficients[kind, k, l] * passed
    return out
