"""Grids of nodes for what varies slowly over a photo. The view's change of scale decides how many
nodes there are."""

from __future__ import annotations

import math

import numpy as np

from moireaug.common.physics.footprint import MIN_BLUR_VARIANCE
from moireaug.engine.cpu import harmonics, optics, tap_weights
from moireaug.engine.cpu.compiling import fill, jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.records import CoarseGrid
from moireaug.engine.cpu.view import (
    blur_jacobian,
    fill_blur,
    jacobian,
    motion_sigma,
    still_variance,
)

VIEW_SAMPLES = 9  # along each axis of the photo, where the view's scale is taken
BLUR_SAMPLES = 5  # along each axis of the photo, where the blur is taken
# limits of views; the reference exposes what is beyond them
MAX_NODES = 65  # of amplitudes, along each axis of the photo
MAX_WEIGHT_NODES = 257  # of tap weights, along each axis
MAX_WEIGHT_TABLES = 2**14  # nodes of tap weights in all, of up to 20 KB each
MAX_STEP = 1e4  # panel pixels from one pixel to the next: a crop may lie beyond the horizon
PASSED_CYCLES_PER_BLUR = 0.8  # above this frequency a Gaussian blur passes less than 1e-5
PIXEL, BLUR = range(2)  # of the Jacobians at a sample: of the pixels, and of what blurs them


@jit_in_place
def sample(positions, k, count):
    """Return the k-th of `count` positions from the first to the last."""
    return positions[(len(positions) - 1) * k // (count - 1)]


@jit_in_place
def _fill_jacobians(jacobians, sites, view):
    """Fill jacobians (samples along v, along u, 2, 4) with those of a view's two cameras, at a few
    places of the photo."""
    for i in range(VIEW_SAMPLES):
        for j in range(VIEW_SAMPLES):
            u, v = sample(sites.cols, j, VIEW_SAMPLES), sample(sites.rows, i, VIEW_SAMPLES)
            by_camera = jacobian(u, v, view.camera)
            by_blur = blur_jacobian(by_camera, u, v, view)
            for k in range(4):
                jacobians[i, j, PIXEL, k], jacobians[i, j, BLUR, k] = by_camera[k], by_blur[k]


@jit_in_place
def _fill_scales(scales, jacobians, blur_camera):
    """Fill scales (samples along v, along u, 2) with how many panel pixels a pixel spans along both
    axes of the panel."""
    for i in range(VIEW_SAMPLES):
        for j in range(VIEW_SAMPLES):
            xu, xv, yu, yv = jacobians[i, j, PIXEL]
            x, y = xu * xu + xv * xv, yu * yu + yv * yv
            if blur_camera.rectified != 0:  # pixels are alike, and what varies is the lens's blur
                xu, xv, yu, yv = jacobians[i, j, BLUR]
                blur = 12 * blur_camera.blur * blur_camera.blur
                x, y = x + (xu * xu + xv * xv) * blur, y + (yu * yu + yv * yv) * blur
            scales[i, j, 0], scales[i, j, 1] = math.sqrt(x), math.sqrt(y)


@jit_in_place
def _fill_highest(highest, cell):
    """Fill highest (2,) with the highest harmonic along both axes, in cycles per panel pixel."""
    fill(highest, 0.0)
    for kind in range(len(cell.period)):
        for axis in range(2):
            highest[axis] = max(highest[axis], cell.orders[kind, axis] / cell.period[kind, axis])


@jit_in_place
def _fastest_change(scales, axis_of_photo, highest, passed):
    """Return how much the logarithm of the view's scale, and the highest frequency, would change
    along u (0) or v (1), if they did over the whole photo as they do where they change fastest.

    passed: the highest frequency that passes the lens, in cycles per sensor pixel.
    """
    least, cycles = 1.0, 0.0
    for i in range(VIEW_SAMPLES):
        for j in range(VIEW_SAMPLES - 1):
            for axis in range(2):
                here, there = scales[i, j, axis], scales[i, j + 1, axis]
                if axis_of_photo == 1:
                    here, there = scales[j, i, axis], scales[j + 1, i, axis]
                high = max(here, there)
                ratio = min(here, there) / high
                least = min(least, ratio)
                cycles = max(cycles, min(high * highest[axis], passed) * (1 - ratio))
    return -math.log(least) * (VIEW_SAMPLES - 1), cycles * (VIEW_SAMPLES - 1)


@jit_in_place
def _largest_step(jacobians):
    """Return the most panel pixels that a pixel spans along an axis, at every second sample."""
    most = 0.0
    for i in range(0, VIEW_SAMPLES, 2):
        for j in range(0, VIEW_SAMPLES, 2):
            for k in range(4):
                most = max(most, abs(jacobians[i, j, PIXEL, k]), abs(jacobians[i, j, BLUR, k]))
    return most


@jit_in_place
def _motion_change(jacobians, camera, blur_camera, axis_of_photo):
    """Return how much motion along the panel's axes would change along u (0) or v (1), as a share
    of the rest of the blur, if it did over the whole photo as it does where it changes sign. There
    the whole blur is least, with a kink if the rest is small."""
    most = 0.0
    for i in range(VIEW_SAMPLES):
        for j in range(VIEW_SAMPLES - 1):
            here, there = jacobians[i, j], jacobians[i, j + 1]
            if axis_of_photo == 1:
                here, there = jacobians[j, i], jacobians[j + 1, i]
            for axis in range(2):
                x, y = 2 * axis, 2 * axis + 1
                blur_u, blur_v = here[BLUR, x], here[BLUR, y]
                a = motion_sigma(blur_u, blur_v, blur_camera)
                b = motion_sigma(there[BLUR, x], there[BLUR, y], blur_camera)
                if a * b < 0:
                    by_u, by_v = here[PIXEL, x], here[PIXEL, y]
                    variance = still_variance(by_u, by_v, camera.fill, blur_u, blur_v, blur_camera)
                    most = max(most, abs(a - b) / math.sqrt(variance + MIN_BLUR_VARIANCE))
    return most * (VIEW_SAMPLES - 1)


@jit_in_place
def _count(steps, fewest, most):
    """Return how many nodes a change of so many steps needs: at least `fewest`, and `most` + 1 if
    it needs more than `most`."""
    return int(min(max(steps + 2, fewest), most + 1))


@jit
def counts(sites, view, budget):
    """Return how many nodes the amplitudes and the tap weights (first axis) of a PixelView need
    along u and v (second axis): (2, 2) int64, one more than the most where they need more, and all
    0 for a view near the horizon; budget: an `ErrorBudget`."""
    camera, blur_camera, out = view.camera, view.blur_camera, np.zeros((2, 2), np.int64)
    jacobians = np.empty((VIEW_SAMPLES, VIEW_SAMPLES, 2, 4))
    _fill_jacobians(jacobians, sites, view)
    # not a comparison that NaN passes
    if not _largest_step(jacobians) < MAX_STEP:
        return out
    scales, highest = np.empty((VIEW_SAMPLES, VIEW_SAMPLES, 2)), np.empty(2)
    _fill_scales(scales, jacobians, blur_camera)
    _fill_highest(highest, view.cell)
    change, cycles = np.empty(2), np.empty(2)
    passed = PASSED_CYCLES_PER_BLUR / max(camera.blur, 1e-6)
    for k in range(2):
        change[k], cycles[k] = _fastest_change(scales, k, highest, passed)
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    for k in range(2):
        if max(change[0], change[1]) < budget.flat_log_scale:
            out[0, k], out[1, k] = 4, 2
            continue
        steps = max(cycles[k] / budget.amplitude_cycles, change[k] / budget.amplitude_log_scale)
        out[0, k] = _count(steps, fewest, MAX_NODES)
        motion_steps = _motion_change(jacobians, camera, blur_camera, k) / budget.weight_motion
        steps = max(change[k] / budget.weight_log_scale, motion_steps)
        out[1, k] = _count(steps, 5, MAX_WEIGHT_NODES)
    return out


@jit_in_place
def _evenly_spaced(positions):
    n = len(positions)
    apart = (positions[n - 1] - positions[0]) / max(n - 1, 1)
    off = 0.0
    for i in range(n):
        off = max(off, abs(positions[i] - positions[0] - i * apart))
    return off <= 1e-6 * apart


@jit
def used_counts(sites, view, budget):
    """Return `counts`, none more than it takes to have a node on each pixel of a line: what is
    interpolated is exact there."""
    out = counts(sites, view, budget)
    for k in range(2):
        positions = sites.cols if k == 0 else sites.rows
        if _evenly_spaced(positions):
            apart = max(len(positions) - 1, 1)
            for grid in range(2):
                degree = 3 - 2 * grid  # amplitudes by cubics, weights by lines
                on_each_pixel = apart * math.ceil(degree / apart) + 1
                out[grid, k] = min(out[grid, k], on_each_pixel)
    return out


@jit
def _narrowed(sites, view):
    """Return whether any of a few sensor pixels over the photo sees more cells than its taps."""
    blur = np.empty((2, 2), np.float64)
    for i in range(BLUR_SAMPLES):
        for j in range(BLUR_SAMPLES):
            u, v = sample(sites.cols, j, BLUR_SAMPLES), sample(sites.rows, i, BLUR_SAMPLES)
            for kind in range(len(view.widths)):
                if fill_blur(blur, u, v, view, kind):
                    return True
    return False


@jit
def can_follow_view(view, sites, dark_around, budget):
    """Return whether the kernels can follow a PixelView: not one near the horizon, nor, if
    `dark_around`, one from so far away that a pixel sees more cells than its taps. Arguments as in
    `coarse_grid_of` and `panel.fill_panel`."""
    count = counts(sites, view, budget)
    amplitudes, weights = max(count[0, 0], count[0, 1]), max(count[1, 0], count[1, 1])
    few = 0 < amplitudes <= MAX_NODES and weights <= MAX_WEIGHT_NODES
    few = few and count[1, 0] * count[1, 1] <= MAX_WEIGHT_TABLES
    return few and not (dark_around and _narrowed(sites, view))


@jit_inlined
def node_line(positions, count):
    """Return `count` nodes from the first to the last position, and the step between two; for one
    position all nodes are there, and the step is 1."""
    first, last = positions[0], positions[len(positions) - 1]
    apart = (last - first) / (count - 1)
    out = np.empty(count, np.float64)
    for i in range(count):
        out[i] = first + i * apart
    return out, apart if last > first else 1.0


@jit_in_place
def bracket(at, first, step, count, degree):
    """Return the first of `degree` + 1 neighbouring nodes around a position, and how many steps
    past it the position is.

    first, step, count: the line of nodes.
    """
    t = (at - first) / step
    base = min(max(math.floor(t) - (degree - 1) // 2, 0), count - 1 - degree)
    return base, t - base


@jit_inlined
def fill_cubics(ends, weight, positions, first, step):
    """Fill ends and weight of `harmonics.interpolate_line` for pixels at ascending positions
    (n,).

    first, step: the first node, and from one to the next.
    """
    done = 0
    for i in range(len(positions)):
        start, t = bracket(positions[i], first, step, len(ends) + 2, 3)
        while done <= start:
            ends[done] = i
            done += 1
        cubic = harmonics.cubic_weights32(t)
        for j in range(4):
            weight[j, i] = cubic[j]
    for j in range(done, len(ends)):
        ends[j] = len(positions)


@jit_inlined
def coarse_grid_of(view, coefficients, sites, budget):
    """Return the CoarseGrid of an image; view: a PixelView. coefficients: see
    `exposure_records.FullView`. budget: an `ErrorBudget`."""
    rows, cols, step, camera = sites.rows, sites.cols, sites.step, view.camera
    count = used_counts(sites, view, budget)
    us, step_u = node_line(cols, count[0, 0])
    vs, step_v = node_line(rows, count[0, 1])
    amplitude = optics.amplitudes(us, vs, camera, view.cell, coefficients)
    harmonics.fold(amplitude)
    least = budget.harmonic_amplitude / max(camera.gain, 1.0)
    terms = harmonics.harmonic_terms(amplitude, least)
    w = len(cols) // step
    lines = np.empty((step, len(vs), len(terms) * w), np.float32)
    ends, weight = np.empty(len(us) - 2, np.int64), np.empty((4, w), np.float32)
    for column in range(step):
        fill_cubics(ends, weight, cols[column::step], us[0], step_u)
        harmonics.interpolate_to_pixels(lines[column], amplitude, terms, ends, weight)
    us, step_uw = node_line(cols, count[1, 0])
    vs, step_vw = node_line(rows, count[1, 1])
    tables, phases, taps = tap_weights.weight_tables(us, vs, view, budget)
    return CoarseGrid(terms, lines, step_v, tables, phases, taps, len(us), step_uw, step_vw)


@jit_inlined
def no_coarse_grid(kinds):
    """Return the CoarseGrid of an image that needs none."""
    tables, phases = np.empty((kinds, 0, 0), np.float32), np.zeros((kinds, 2), np.int64)
    terms, lines = np.empty((0, 4), np.int64), np.empty((1, 0, 0), np.float32)
    return CoarseGrid(terms, lines, 1.0, tables, phases, np.zeros(kinds, np.int64), 2, 1.0, 1.0)
