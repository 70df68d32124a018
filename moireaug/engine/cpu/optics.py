"""The harmonics that a sensor pixel sees of the panel, through its aperture and lens.

They change slowly over a photo: they are computed on a grid of nodes and interpolated by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.cpu.compiling import jit, jit_in_place
from moireaug.engine.cpu.physics import optics
from moireaug.engine.cpu.view import jacobian

# of a table whose error is below any budget: at most 2e-6, as that of every table of the kernels
MIN_TRANSFER_STEPS, TRANSFER_STEPS_PER_CYCLE, MAX_TRANSFER_STEPS = 512, 64, 2**16


@jit_in_place
def transfer_steps(most):
    """Return how many steps a `transfer_table` needs up to a frequency in cycles per sensor
    pixel."""
    return min(max(MIN_TRANSFER_STEPS, int(TRANSFER_STEPS_PER_CYCLE * most)), MAX_TRANSFER_STEPS)


@jit
def transfer_table(camera, most, steps):
    """Return the modulation transfer along one axis at steps + 2 frequencies in cycles per sensor
    pixel, from 0 to `most` and one step beyond."""
    out, still = np.empty(steps + 2, np.float64), (camera.fill, camera.blur, camera.olpf, 0.0, 0.0)
    for i in range(steps + 2):
        out[i] = optics.transfer(i * most / steps, 0.0, still)
    return out


@jit_in_place
def look_up(table, f):
    """Return the value of a table of an even, smooth function at f >= 0, in the table's steps; past
    its end, what it ends with: between the places where frequencies were sampled, some are
    higher."""
    f = min(f, len(table) - 2.0)
    i = min(int(f), len(table) - 2)
    a, b, g = table[i], table[i + 1], f - i
    # a parabola through two neighbours, of the mean curvature at both
    before, after = table[abs(i - 1)], table[min(i + 2, len(table) - 1)]
    return a + g * (b - a) - g * (1 - g) / 4 * (before - a - b + after)


@jit_in_place
def still_transfer_at(fu, fv, table, steps_per_cycle):
    """Return the transfer of aperture and lens, without motion, at a frequency in cycles per sensor
    pixel along u and v.

    table: from `transfer_table`. steps_per_cycle: its steps per cycle per sensor pixel.
    """
    return look_up(table, abs(fu) * steps_per_cycle) * look_up(table, abs(fv) * steps_per_cycle)


@jit_in_place
def transfer_at(fu, fv, table, steps_per_cycle, camera):
    """Return the transfer of aperture, lens and motion; arguments as in `still_transfer_at`."""
    passed = still_transfer_at(fu, fv, table, steps_per_cycle)
    if camera.motion_x != 0 or camera.motion_y != 0:
        along = fu * camera.motion_x + fv * camera.motion_y
        passed *= math.exp(-2 * math.pi * math.pi * along * along)
    return passed


@jit_in_place
def _fill_steps(steps, us, vs, camera, cell):
    """Fill steps (rows, cols, kinds, 4) with the cells along x and y from one sensor pixel to the
    next along u, and then along v. Return the highest frequency, in cycles per sensor pixel."""
    most = 1e-9
    for r in range(len(vs)):
        for c in range(len(us)):
            xu, xv, yu, yv = jacobian(us[c], vs[r], camera)
            for kind in range(len(cell.period)):
                (px, py), (k, l) = cell.period[kind], cell.orders[kind]
                ux, uy, vx, vy = xu / px, yu / py, xv / px, yv / py
                step = steps[r, c, kind]
                step[0], step[1], step[2], step[3] = ux, uy, vx, vy
                most = max(most, k * abs(ux) + l * abs(uy), k * abs(vx) + l * abs(vy))
    return most


@jit_in_place
def _transmit(out, coefficients, step, table, steps_per_cycle, camera):
    """Fill out (n, m), which holds zeros, with the amplitudes of harmonics (n, m) after the optics
    at a node.

    step: (4,), from `_fill_steps`. table, steps_per_cycle: as in `transfer_at`.
    """
    ux, uy, vx, vy = step
    n, m = coefficients.shape
    for k in range(n):
        for l in range(m):
            if coefficients[k, l] == 0:
                continue
            fu, fv = k * ux + (l - m // 2) * uy, k * vx + (l - m // 2) * vy
            out[k, l] = coefficients[k, l] * transfer_at(fu, fv, table, steps_per_cycle, camera)


@jit
def amplitudes(us, vs, camera, cell, coefficients):
    """Return (rows, cols, kinds, n, m) float32, each harmonic's amplitude on nodes of the photo.

    coefficients: (kinds, n, m) of harmonics k = 0 ... K and l = -L ... L, where n = K + 1 and
    m = 2 L + 1.
    """
    kinds, n, m = coefficients.shape
    steps = np.empty((len(vs), len(us), kinds, 4), np.float64)
    most = _fill_steps(steps, us, vs, camera, cell)
    count = transfer_steps(most)
    table, steps_per_cycle = transfer_table(camera, most, count), count / most
    out = np.zeros((len(vs), len(us), kinds, n, m), np.float32)
    for r in range(len(vs)):
        for c in range(len(us)):
            for kind in range(kinds):
                step, amplitude = steps[r, c, kind], out[r, c, kind]
                _transmit(amplitude, coefficients[kind], step, table, steps_per_cycle, camera)
    return out
