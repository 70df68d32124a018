"""What varies slowly over a photo, on a grid of nodes: as many as the view's change of scale
needs."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import harmonics, optics
from moireaug.engine.compiling import inner, loop
from moireaug.engine.record import Nodes
from moireaug.engine.view import jacobian

FLAT = 5e-4  # if the logarithm of the view's scale changes by less, 4 and 2 nodes are enough
MOST = 65
SAMPLES = 5
# how much the logarithm of the view's scale may change between two nodes of the amplitudes, and of
# the weights
STEP, STEP_OF_WEIGHTS = 0.15, 0.06
CYCLES = 0.12  # and how much the highest frequency may, in cycles per sensor pixel
PASSED = 0.8  # in units of 1 / blur: a frequency of which a Gaussian passes less than 1e-5


@loop
def _counts(rows, cols, camera, period, n, m):
    """Return how many nodes the amplitudes and the weights (first axis) need along u and v (second
    axis): (2, 2) int64, MOST + 1 where they need more than MOST.

    n, m: K + 1 and 2 L + 1.
    """
    # along both axes of the panel, how many cells a sensor pixel spans
    cells = np.empty((SAMPLES * SAMPLES, 2), np.float64)
    for i in range(len(cells)):
        v = rows[(len(rows) - 1) * (i // SAMPLES) // (SAMPLES - 1)]
        u = cols[(len(cols) - 1) * (i % SAMPLES) // (SAMPLES - 1)]
        xu, xv, yu, yv = jacobian(u, v, camera)
        cells[i, 0], cells[i, 1] = math.hypot(xu, xv) / period[0], math.hypot(yu, yv) / period[1]
    # the fastest change of that, extrapolated to the whole photo
    change, cycles, passed = np.zeros(2), np.zeros(2), PASSED / max(camera.blur, 1e-6)
    for i in range(len(cells)):
        for k in range(2):
            other = i + (1 if k == 0 else SAMPLES)
            if other >= len(cells) or (k == 0 and other % SAMPLES == 0):
                continue
            for axis in range(2):
                low, high = (
                    min(cells[i, axis], cells[other, axis]),
                    max(cells[i, axis], cells[other, axis]),
                )
                top = min(high * (n - 1 if axis == 0 else m // 2), passed)
                change[k] = max(change[k], math.log(high / low) * (SAMPLES - 1))
                cycles[k] = max(cycles[k], top * (1 - low / high) * (SAMPLES - 1))
    out = np.empty((2, 2), np.int64)
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    for k in range(2):
        if max(change[0], change[1]) < FLAT:
            out[0, k], out[1, k] = 4, 2
            continue
        needed, of_weights = max(cycles[k] / CYCLES, change[k] / STEP), change[k] / STEP_OF_WEIGHTS
        out[0, k] = int(min(max(needed + 2, fewest), MOST + 1))
        out[1, k] = int(min(max(of_weights + 2, 5), MOST + 1))
    return out


@loop
def _narrowed(rows, cols, camera, period, taps, widths, skew):
    """Return whether any of a few sensor pixels over the photo sees more cells than are looked
    at."""
    spread = np.empty((2, 2), np.float64)
    for i in range(SAMPLES * SAMPLES):
        v = rows[(len(rows) - 1) * (i // SAMPLES) // (SAMPLES - 1)]
        u = cols[(len(cols) - 1) * (i % SAMPLES) // (SAMPLES - 1)]
        for kind in range(len(widths)):
            if optics.spreads(spread, u, v, camera, period, widths[kind], skew[kind], taps):
                return True
    return False


@loop
def fits(camera, cell, coefficients, widths, skew, sites, dark):
    """Return whether the kernels can follow a view: not one near the horizon, nor, if `dark`, one
    from so far away that a pixel sees more cells than are looked at. Arguments as in
    `expose.expose` and `panel.show`."""
    _, n, m = coefficients.shape
    if dark and _narrowed(sites.rows, sites.cols, camera, cell.period, cell.taps, widths, skew):
        return False
    counts, most = _counts(sites.rows, sites.cols, camera, cell.period, n, m), 0
    for k in range(2):
        most = max(most, counts[0, k], counts[1, k])
    return most <= MOST


@loop
def _line(positions, count):
    """Return `count` nodes from the first to the last position, and the step between two."""
    first, last = positions[0], positions[len(positions) - 1]
    step = (last - first) / (count - 1) if last > first else 1.0
    out = np.empty(count, np.float64)
    for i in range(count):
        out[i] = first + i * step
    return out, step


@inner
def bracket(at, first, step, count, most):
    """Return the first of `most` + 1 neighbouring nodes around a position, and how many steps
    past it the position is.

    first, step, count: the line of nodes.
    """
    t = (at - first) / step
    base = min(max(math.floor(t) - (most - 1) // 2, 0), count - 1 - most)
    return base, t - base


@loop
def prepare(camera, cell, coefficients, widths, skew, sites):
    """Return the Nodes of an image; arguments as in `record.Exposure`."""
    rows, cols, step = sites.rows, sites.cols, sites.step
    _, n, m = coefficients.shape
    counts = _counts(rows, cols, camera, cell.period, n, m)
    us, step_u = _line(cols, counts[0, 0])
    vs, step_v = _line(rows, counts[0, 1])
    amplitude = optics.amplitudes(us, vs, camera, cell.period, coefficients)
    harmonics.fold(amplitude)
    terms = harmonics.terms_of(amplitude)
    w = len(cols) // step
    start, weight = np.empty(w, np.int64), np.empty((w, 4), np.float64)
    lines = np.empty((step, len(vs), len(terms) * w), np.float32)
    for column in range(step):
        for i in range(w):
            start[i], t = bracket(cols[column + i * step], us[0], step_u, len(us), 3)
            harmonics.lagrange(weight[i], t)
        harmonics.along_row(lines[column], amplitude, terms, start, weight)
    us, step_uw = _line(cols, counts[1, 0])
    vs, step_vw = _line(rows, counts[1, 1])
    tables = optics.weights(us, vs, camera, cell.period, cell.taps, widths, skew)
    return Nodes(terms, lines, step_v, tables, step_uw, step_vw)
