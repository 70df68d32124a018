"""What is smooth over a photo, on a grid of nodes: as many as the view's change of scale needs."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import harmonics, optics
from moireaug.engine.compiling import kernel, loop
from moireaug.engine.record import LANES, Nodes
from moireaug.engine.view import jacobian

FLAT = 5e-4  # the logarithm of the view's scale changes by less: four nodes and two say it all
MOST = 65
SAMPLES = 5
# between two nodes of the amplitudes and of the weights, the logarithm of the view's scale changes by at most
STEP, STEP_OF_WEIGHTS = 0.15, 0.06
CYCLES = 0.12  # and the highest frequency by so many cycles a sensor pixel
PASSED = 0.8  # in units of 1 / blur: a frequency of which a Gaussian passes less than 1e-5
REACH = 3  # a group's cubic goes through four nodes


@loop
def _counts(rows, cols, camera, period, n, m):
    """Return how many nodes a side the amplitudes and the weights need, more than MOST where too many."""
    # along both axes of the panel, how many cells a sensor pixel spans
    cells = np.empty((SAMPLES * SAMPLES, 2), np.float64)
    for i in range(len(cells)):
        v = rows[(len(rows) - 1) * (i // SAMPLES) // (SAMPLES - 1)]
        u = cols[(len(cols) - 1) * (i % SAMPLES) // (SAMPLES - 1)]
        xu, xv, yu, yv = jacobian(u, v, camera)
        cells[i, 0], cells[i, 1] = math.hypot(xu, xv) / period[0], math.hypot(yu, yv) / period[1]
    # how fast that changes where it does so fastest, as if over the whole photo
    change, cycles, passed = 0.0, 0.0, PASSED / max(camera.blur, 1e-6)
    for i in range(len(cells)):
        for k in range(2):
            other = i + (1 if k == 0 else SAMPLES)
            if other >= len(cells) or (k == 0 and other % SAMPLES == 0):
                continue
            for axis in range(2):
                low, high = min(cells[i, axis], cells[other, axis]), max(cells[i, axis], cells[other, axis])
                top = min(high * (n - 1 if axis == 0 else m // 2), passed)
                change = max(change, math.log(high / low) * (SAMPLES - 1))
                cycles = max(cycles, top * (1 - low / high) * (SAMPLES - 1))
    if change < FLAT:
        return 4, 2
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    needed, of_weights = max(cycles / CYCLES, change / STEP), change / STEP_OF_WEIGHTS
    return int(min(max(needed + 2, fewest), MOST + 1)), int(min(max(of_weights + 2, 5), MOST + 1))


@loop
def _narrowed(rows, cols, camera, period, taps, widths, skew):
    """Return whether a sensor pixel ever sees more cells than are looked at."""
    spread = np.empty((2, 2), np.float64)
    for i in range(SAMPLES * SAMPLES):
        v = rows[(len(rows) - 1) * (i // SAMPLES) // (SAMPLES - 1)]
        u = cols[(len(cols) - 1) * (i % SAMPLES) // (SAMPLES - 1)]
        for kind in range(len(widths)):
            if optics.spreads(spread, u, v, camera, period, widths[kind], skew[kind], taps):
                return True
    return False


@kernel
def fits(camera, cell, coefficients, widths, skew, sites, dark):
    """Return whether the kernels can follow a view: not one that comes near the horizon, nor past the end of a picture
    from so far away that cells are left out. Arguments as in `expose.expose` and `panel.show`."""
    _, n, m = coefficients.shape
    if dark and _narrowed(sites.rows, sites.cols, camera, cell.period, cell.taps, widths, skew):
        return False
    count, coarse = _counts(sites.rows, sites.cols, camera, cell.period, n, m)
    return max(count, coarse) <= MOST


@loop
def _line(positions, count):
    """Return `count` nodes from the first to the last position, and the way between two."""
    first, last = positions[0], positions[len(positions) - 1]
    step = (last - first) / (count - 1) if last > first else 1.0
    out = np.empty(count, np.float64)
    for i in range(count):
        out[i] = first + i * step
    return out, step


@loop
def bracket(at, first, step, count, most):
    """Return the first of `most` + 1 neighbouring nodes around a position, and where from it the position is.

    first, step, count: the line of nodes.
    """
    t = (at - first) / step
    base = min(max(math.floor(t) - (most - 1) // 2, 0), count - 1 - most)
    return base, t - base


@kernel
def prepare(camera, cell, coefficients, widths, skew, sites):
    """Return the Nodes of an image; arguments as in `expose.expose`."""
    rows, cols, step = sites.rows, sites.cols, sites.step
    kinds, n_k, n_l = coefficients.shape
    count, coarse = _counts(rows, cols, camera, cell.period, n_k, n_l)
    us, step_u = _line(cols, count)
    vs, step_v = _line(rows, count)
    w = len(cols) // step
    # pixels to a group, whose lanes they do not fill where its cubic would reach too far
    per = max(1, min(LANES * max(1, w // 192), REACH * w // (count - 1)))
    per = per if per < LANES else per // LANES * LANES
    groups = (w + per - 1) // per
    middle, start = np.empty(groups, np.float64), np.empty(groups, np.int64)
    to_power = np.empty((groups, 4 * harmonics.POWERS), np.float64)
    half = max((cols[len(cols) - 1] - cols[0]) / max(len(cols) - 1, 1) * step * per / 2, 1e-9)
    for g in range(groups):
        middle[g] = cols[0] + (2 * g + 1) * half
        start[g], t = bracket(middle[g], us[0], step_u, count, 3)
        harmonics.monomials(to_power[g], t, half / step_u)
    amplitude, n_k, n_l = harmonics.trim(*optics.amplitudes(us, vs, camera, cell.period, coefficients))
    volume = kinds * n_k * n_l
    harmonics.fold(amplitude, n_l)
    cubics = np.empty((count, harmonics.POWERS * groups * volume), np.float32)
    for r in range(count):
        harmonics.cubics(cubics[r], amplitude[r], to_power, start, volume)
    order, powers = harmonics.orders(cubics, groups, kinds, n_k, n_l)
    us, step_uw = _line(cols, coarse)
    vs, step_vw = _line(rows, coarse)
    tables, phases, taps = optics.weights(us, vs, camera, cell.period, cell.taps, widths, skew)
    return Nodes(per, cubics, order, powers, n_k, n_l, middle, half, step_v, tables, phases, taps, step_uw, step_vw)
