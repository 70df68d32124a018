"""What is smooth over a photo, on a grid of nodes: as many as the view's change of scale needs."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import harmonics, optics
from moireaug.engine.compiling import kernel, loop
from moireaug.engine.record import LANES, Nodes
from moireaug.engine.view import jacobian

FLAT = 1.0005  # the view's scale changes by less: four nodes and two say it all
FEW, MORE, MOST = 9, 17, 33
STEP = 0.06  # the logarithm of the scale between two nodes of the weights


@loop
def _change(rows, cols, camera):
    """Return by which factor the view's scale changes over the photo."""
    low, high = math.inf, 0.0
    for i in range(3):
        for k in range(3):
            v = rows[(len(rows) - 1) * i // 2]
            u = cols[(len(cols) - 1) * k // 2]
            xu, xv, yu, yv = jacobian(u, v, camera)
            scale = xu * xu + xv * xv + yu * yu + yv * yv
            low, high = min(low, scale), max(high, scale)
    return math.sqrt(high / low)


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


@loop
def grouping(w):
    """Return how many of a plane's w columns are a group, and how many lanes it takes.

    Small sensors do not fill the lanes: a group's cubics must not reach too far.
    """
    per = LANES * max(1, w // 192) if w >= 3 * LANES else (w + 3) // 4
    return per, (per + LANES - 1) // LANES * LANES


@kernel
def prepare(camera, cell, coefficients, widths, skew, sites):
    """Return the Nodes of an image; arguments as in `expose.expose`."""
    rows, cols, step = sites.rows, sites.cols, sites.step
    change = _change(rows, cols, camera)
    flat = change < FLAT and camera.k1 == 0 and camera.k2 == 0
    count = 4 if flat else FEW if change < 2.5 else MORE if change < 6 else MOST
    us, step_u = _line(cols, count)
    vs, step_v = _line(rows, count)
    w = len(cols) // step
    per, _ = grouping(w)
    groups = (w + per - 1) // per
    middle, start = np.empty(groups, np.float64), np.empty(groups, np.int64)
    to_power = np.empty((groups, 4 * harmonics.POWERS), np.float64)
    half = max((cols[len(cols) - 1] - cols[0]) / max(len(cols) - 1, 1) * step * per / 2, 1e-9)
    for g in range(groups):
        middle[g] = cols[g * per * step] + half
        start[g], t = bracket(middle[g], us[0], step_u, count, 3)
        harmonics.monomials(to_power[g], t, half / step_u)
    amplitude, n_k, n_l = harmonics.trim(*optics.amplitudes(us, vs, camera, cell.period, coefficients))
    kinds = len(coefficients)
    volume = kinds * n_k * n_l
    harmonics.fold(amplitude, n_l)
    cubics = np.empty((count, harmonics.POWERS * groups * volume), np.float32)
    for r in range(count):
        harmonics.cubics(cubics[r], amplitude[r], to_power, start, volume)
    order, powers = harmonics.orders(cubics, groups, kinds, n_k, n_l)
    coarse = 2 if flat else min(max(int(math.log(change) / STEP) + 2, 5), MOST)
    us, step_uw = _line(cols, coarse)
    vs, step_vw = _line(rows, coarse)
    tables, phases = optics.weights(us, vs, camera, cell.period, cell.taps, widths, skew)
    return Nodes(cubics, order, powers, n_k, n_l, middle, half, step_v, tables, phases, step_uw, step_vw)
