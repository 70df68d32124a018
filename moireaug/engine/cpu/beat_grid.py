"""The grid of nodes on which a binned reading's beats are computed: how many a view needs, and the
harmonics' frequencies and the bins' sides there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu import optics
from moireaug.engine.cpu.coarse_grid import VIEW_SAMPLES, sample
from moireaug.engine.cpu.compiling import jit, jit_in_place
from moireaug.engine.cpu.physics import bins
from moireaug.engine.cpu.view import jacobian
from moireaug.engine.lower.budget import REFERENCE_AMPLITUDE

MOTION_SIDE = 12**0.5  # side of a bin that blurs as much as motion with a standard deviation of 1
MAX_BEAT_NODES = 192  # along each axis of the photo; the reference exposes what needs more


class BeatGrid(NamedTuple):
    """Harmonics and bins at points of a reading.

    Args:
        frequency: (rows, cols, K, 2) float64, of each harmonic along u and v, in cycles per sensor
            pixel.
        sides: (rows, cols, 4) float64, u and v of the bins' two sides, in sensor pixels; at least
            a pixel long. triangle: float, see `bin_geometry.Bins`.
    """

    frequency: np.ndarray
    sides: np.ndarray
    triangle: float


@jit_in_place
def fill_bin(frequency, side, steps, camera, b, i, orders):
    """Fill frequency (K, 2) and side (4,) of a `BeatGrid` at a point.

    steps: panel pixels per sensor pixel there, from `view.jacobian`. The rest as in `grid_at`.
    """
    xu, xv, yu, yv = steps
    for h in range(len(orders)):
        k, l = orders[h, 0] / b.period[0], orders[h, 1] / b.period[1]
        frequency[h, 0] = k * xu + l * yu
        frequency[h, 1] = k * xv + l * yv
    side[0], side[1], side[2], side[3] = camera.scale_u * b.enlargement[i], 0.0, 0.0, 0.0
    side[3] = camera.scale_v * b.enlargement[i]
    if b.sampled:
        side[0], side[3] = 1.0, 1.0
    elif camera.rectified != 0:
        pixel = camera.alpha * b.enlargement[i]
        first, second = bins.image_pixel_sides(xu, xv, yu, yv, pixel)
        side[0], side[1], side[2], side[3] = first[0], first[1], second[0], second[1]


@jit
def grid_at(us, vs, camera, b, i, orders):
    """Return the BeatGrid of image i and some orders at points of a reading about its centre.

    camera: of its sensor pixels. b: see `exposure_records.Beats`.
    """
    frequency = np.empty((len(vs), len(us), len(orders), 2), np.float64)
    sides = np.empty((len(vs), len(us), 4), np.float64)
    for r in range(len(vs)):
        for c in range(len(us)):
            steps = jacobian(us[c], vs[r], camera)
            fill_bin(frequency[r, c], sides[r, c], steps, camera, b, i, orders)
    return BeatGrid(frequency, sides, b.triangle[i])


@jit
def sampled_grid(sites, camera, b, i):
    """Return the BeatGrid at a few points over the reading; arguments as in `grid_at`."""
    us, vs = np.empty(VIEW_SAMPLES, np.float64), np.empty(VIEW_SAMPLES, np.float64)
    for k in range(VIEW_SAMPLES):
        us[k], vs[k] = sample(sites.cols, k, VIEW_SAMPLES), sample(sites.rows, k, VIEW_SAMPLES)
    return grid_at(us, vs, camera, b, i, b.orders)


@jit
def transfer_of(grid, camera):
    """Return a table of the modulation transfer for frequencies up to a little more than those of a
    grid, and its steps per cycle per sensor pixel."""
    most, frequency = 1e-9, grid.frequency
    rows, cols, n, _ = frequency.shape
    for r in range(rows):
        for c in range(cols):
            for h in range(n):
                most = max(most, abs(frequency[r, c, h, 0]), abs(frequency[r, c, h, 1]))
    # of views near the horizon no more, or a step would span many cycles
    most = min(1.25 * most, optics.MAX_TRANSFER_STEPS / optics.TRANSFER_STEPS_PER_CYCLE)
    steps = optics.transfer_steps(most)
    return optics.transfer_table(camera, most, steps), steps / most


@jit_in_place
def _fastest_change(grid, amplitude, axis, camera, least):
    """Return how much the beats' frequency would change along u (0) or v (1), in cycles per photo
    pixel, or per motion that blurs as much if that is more, if it did over the whole photo as it
    does where it changes fastest.

    amplitude: (K,), of harmonics in a reading; those below `least` are left out. The error
    of a cubic grows with the fourth power of the step: fainter ones need fewer nodes.
    """
    most, frequency = 0.0, grid.frequency
    for h in range(frequency.shape[2]):
        if amplitude[h] < least:
            continue
        weight = min(amplitude[h] / REFERENCE_AMPLITUDE, 1.0) ** 0.25
        for i in range(VIEW_SAMPLES):
            for j in range(VIEW_SAMPLES - 1):
                here, there, side = frequency[i, j, h], frequency[i, j + 1, h], grid.sides[i, j]
                if axis == 1:
                    here, there, side = frequency[j, i, h], frequency[j + 1, i, h], grid.sides[j, i]
                u, v = there[0] - here[0], there[1] - here[1]
                change = max(abs(u * side[0] + v * side[1]), abs(u * side[2] + v * side[3]))
                moved = MOTION_SIDE * abs(u * camera.motion_x + v * camera.motion_y)
                most = max(most, weight * max(change, abs(u), abs(v), moved))
    return most * (VIEW_SAMPLES - 1)


@jit_in_place
def _node_count(steps, fewest, pixels):
    """Return how many nodes a change of frequency by so many steps needs: at most one per pixel,
    and at most MAX_BEAT_NODES + 1."""
    if steps < 5e-6:
        return 4
    return int(min(max(steps + 2, fewest), max(pixels, 4), MAX_BEAT_NODES + 1))


@jit
def node_counts(grid, amplitude, sites, camera, budget):
    """Return how many nodes the amplitudes need along u and v; grid: from `sampled_grid`,
    amplitude: from `beat_terms.max_amplitudes`, budget: an `ErrorBudget`."""
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    across = _fastest_change(grid, amplitude, 0, camera, budget.beat_amplitude) / budget.beat_cycles
    down = _fastest_change(grid, amplitude, 1, camera, budget.beat_amplitude) / budget.beat_cycles
    n_u = _node_count(across, fewest, len(sites.cols))
    return n_u, _node_count(down, fewest, len(sites.rows))
