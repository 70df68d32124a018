"""What varies slowly over a photo, on a grid of nodes: as many as the view's change of scale
needs."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import harmonics, optics, weights
from moireaug.engine.compiling import fill, inner, loop, part
from moireaug.engine.exposure_records import Nodes
from moireaug.engine.view import jacobian

FLAT = 5e-4  # if the logarithm of the view's scale changes by less, 4 and 2 nodes are enough
MOST = 65
SAMPLES = 9  # along each axis of the photo, of how its view's scale changes
CELL_SAMPLES = 5  # and of how many cells a pixel sees
# how much the logarithm of the view's scale may change between two nodes of the amplitudes, and of
# the weights
STEP, STEP_OF_WEIGHTS = 0.15, 0.06
SWING = 0.3  # and how much the motion, where it changes sign, as a share of the rest of the spread
CYCLES = 0.12  # and how much the highest frequency may, in cycles per sensor pixel
PASSED = 0.8  # in units of 1 / blur: a frequency of which a Gaussian passes less than 1e-5


@inner
def sample(positions, k, count):
    """Return the k-th of `count` positions from the first to the last."""
    return positions[(len(positions) - 1) * k // (count - 1)]


@inner
def _fill_scales(seen, rows, cols, camera, lens):
    """Fill seen (samples along v, along u, 2) with how many of the panel's pixels a pixel spans
    along both axes of the panel."""
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            u, v = sample(cols, j, SAMPLES), sample(rows, i, SAMPLES)
            xu, xv, yu, yv = jacobian(u, v, camera)
            x, y = xu * xu + xv * xv, yu * yu + yv * yv
            if lens.rectified != 0:  # pixels are alike, and what varies is the lens's spread
                xu, xv, yu, yv = jacobian(u, v, lens)
                blur = 12 * lens.blur * lens.blur
                x, y = x + (xu * xu + xv * xv) * blur, y + (yu * yu + yv * yv) * blur
            seen[i, j, 0], seen[i, j, 1] = math.sqrt(x), math.sqrt(y)


@inner
def _fill_highest(highest, cell):
    """Fill highest (2,) with the highest harmonic along both axes, in cycles per panel pixel."""
    fill(highest, 0.0)
    for kind in range(len(cell.period)):
        for axis in range(2):
            highest[axis] = max(highest[axis], cell.orders[kind, axis] / cell.period[kind, axis])


@inner
def _fastest(seen, axis_of_photo, highest, passed):
    """Return how much the logarithm of the view's scale, and the highest frequency, change along u
    (0) or v (1), if they do so over the whole photo as where they change fastest.

    passed: the highest frequency that passes the lens, in cycles per sensor pixel.
    """
    least, cycles = 1.0, 0.0
    for i in range(SAMPLES):
        for j in range(SAMPLES - 1):
            for axis in range(2):
                here, there = seen[i, j, axis], seen[i, j + 1, axis]
                if axis_of_photo == 1:
                    here, there = seen[j, i, axis], seen[j + 1, i, axis]
                high = max(here, there)
                ratio = min(here, there) / high
                least = min(least, ratio)
                cycles = max(cycles, min(high * highest[axis], passed) * (1 - ratio))
    return -math.log(least) * (SAMPLES - 1), cycles * (SAMPLES - 1)


@inner
def _swing(rows, cols, camera, lens, axis_of_photo):
    """Return how much the motion along the panel's axes changes along u (0) or v (1), as a share of
    the rest of the spread, if it does so over the whole photo as where it changes sign: there the
    whole spread has its least value, with a kink if the rest is small."""
    found = 0.0
    for i in range(SAMPLES):
        for j in range(SAMPLES - 1):
            u, v = sample(cols, j, SAMPLES), sample(rows, i, SAMPLES)
            u2, v2 = sample(cols, j + 1, SAMPLES), v
            if axis_of_photo == 1:
                u, v = sample(cols, i, SAMPLES), sample(rows, j, SAMPLES)
                u2, v2 = u, sample(rows, j + 1, SAMPLES)
            by_camera = jacobian(u, v, camera)
            here = weights.by_lens(by_camera, u, v, camera, lens)
            there = weights.by_lens(jacobian(u2, v2, camera), u2, v2, camera, lens)
            for axis in range(2):
                x, y = 2 * axis, 2 * axis + 1
                a = weights.moved(here[x], here[y], lens)
                b = weights.moved(there[x], there[y], lens)
                if a * b < 0:
                    still = weights.still(
                        by_camera[x], by_camera[y], camera.fill, here[x], here[y], lens
                    )
                    found = max(found, abs(a - b) / math.sqrt(still + weights.MIN_VARIANCE))
    return found * (SAMPLES - 1)


@inner
def _count(steps, fewest):
    """Return how many nodes are as many steps apart: at least `fewest`, and at most MOST + 1."""
    return int(min(max(steps + 2, fewest), MOST + 1))


@loop
def counts(rows, cols, camera, lens, cell):
    """Return how many nodes the amplitudes and the weights (first axis) need along u and v (second
    axis): (2, 2) int64, MOST + 1 where they need more than MOST."""
    seen, highest = np.empty((SAMPLES, SAMPLES, 2)), np.empty(2)
    _fill_scales(seen, rows, cols, camera, lens)
    _fill_highest(highest, cell)
    change, cycles, passed = np.empty(2), np.empty(2), PASSED / max(camera.blur, 1e-6)
    for k in range(2):
        change[k], cycles[k] = _fastest(seen, k, highest, passed)
    out = np.empty((2, 2), np.int64)
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    for k in range(2):
        if max(change[0], change[1]) < FLAT:
            out[0, k], out[1, k] = 4, 2
            continue
        out[0, k] = _count(max(cycles[k] / CYCLES, change[k] / STEP), fewest)
        swing = _swing(rows, cols, camera, lens, k) / SWING
        out[1, k] = _count(max(change[k] / STEP_OF_WEIGHTS, swing), 5)
    return out


@loop
def _narrowed(rows, cols, camera, lens, cell, widths, skew):
    """Return whether any of a few sensor pixels over the photo sees more cells than are looked
    at."""
    blur = np.empty((2, 2), np.float64)
    for i in range(CELL_SAMPLES):
        for j in range(CELL_SAMPLES):
            u, v = sample(cols, j, CELL_SAMPLES), sample(rows, i, CELL_SAMPLES)
            for kind in range(len(widths)):
                subpixel = weights.Subpixel(cell.period[kind], widths[kind], skew[kind])
                if weights.fill_blur(blur, u, v, camera, lens, subpixel, cell.radius):
                    return True
    return False


@loop
def fits(camera, lens, cell, widths, skew, sites, dark):
    """Return whether the kernels can follow a view: not one near the horizon, nor, if `dark`, one
    from so far away that a pixel sees more cells than are looked at. Arguments as in
    `expose.expose` and `panel.show`."""
    if dark and _narrowed(sites.rows, sites.cols, camera, lens, cell, widths, skew):
        return False
    count, most = counts(sites.rows, sites.cols, camera, lens, cell), 0
    for k in range(2):
        most = max(most, count[0, k], count[1, k])
    return most <= MOST


@part
def line_of(positions, count):
    """Return `count` nodes from the first to the last position, and the step between two; for one
    position all nodes are there, and the step is 1."""
    first, last = positions[0], positions[len(positions) - 1]
    apart = (last - first) / (count - 1)
    out = np.empty(count, np.float64)
    for i in range(count):
        out[i] = first + i * apart
    return out, apart if last > first else 1.0


@inner
def bracket(at, first, step, count, most):
    """Return the first of `most` + 1 neighbouring nodes around a position, and how many steps
    past it the position is.

    first, step, count: the line of nodes.
    """
    t = (at - first) / step
    base = min(max(math.floor(t) - (most - 1) // 2, 0), count - 1 - most)
    return base, t - base


@part
def cubics(ends, weight, positions, first, step):
    """Fill ends and weight of `harmonics.along_row` for pixels at (n,) ascending positions.

    first, step: the first node, and from one to the next.
    """
    four, done = np.empty(4, np.float32), 0
    for i in range(len(positions)):
        start, t = bracket(positions[i], first, step, len(ends) + 2, 3)
        while done <= start:
            ends[done] = i
            done += 1
        harmonics.lagrange(four, t)
        for j in range(4):
            weight[j, i] = four[j]
    for j in range(done, len(ends)):
        ends[j] = len(positions)


@part
def prepare(camera, lens, cell, coefficients, widths, skew, sites):
    """Return the Nodes of an image; arguments as in `exposure_records.Exposure`."""
    rows, cols, step = sites.rows, sites.cols, sites.step
    count = counts(rows, cols, camera, lens, cell)
    us, step_u = line_of(cols, count[0, 0])
    vs, step_v = line_of(rows, count[0, 1])
    amplitude = optics.amplitudes(us, vs, camera, cell, coefficients)
    harmonics.fold(amplitude)
    terms = harmonics.terms_of(amplitude, camera.gain)
    w = len(cols) // step
    lines = np.empty((step, len(vs), len(terms) * w), np.float32)
    ends, weight = np.empty(len(us) - 2, np.int64), np.empty((4, w), np.float32)
    for column in range(step):
        cubics(ends, weight, cols[column::step], us[0], step_u)
        harmonics.along_row(lines[column], amplitude, terms, ends, weight)
    us, step_uw = line_of(cols, count[1, 0])
    vs, step_vw = line_of(rows, count[1, 1])
    tables, phases, taps = weights.tap_weight_tables(us, vs, camera, lens, cell, widths, skew)
    return Nodes(terms, lines, step_v, tables, phases, taps, len(us), step_uw, step_vw)


@part
def none(kinds):
    """Return the Nodes of an image that needs none."""
    tables, phases = np.empty((kinds, 0, 0), np.float32), np.zeros((kinds, 2), np.int64)
    terms, lines = np.empty((0, 4), np.int64), np.empty((1, 0, 0), np.float32)
    return Nodes(terms, lines, 1.0, tables, phases, np.zeros(kinds, np.int64), 2, 1.0, 1.0)
