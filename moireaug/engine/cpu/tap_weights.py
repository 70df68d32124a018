"""The tap weights of a sensor pixel: the shares of its light that come from the cells around it, by
phase, which is where between two cells the pixel looks.

They change slowly over a photo: they are computed on a grid of nodes and interpolated linearly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.camera.exposure.footprint import NEAREST_GUARD_SHARE
from moireaug.engine.cpu.compiling import fill, jit, jit_in_place
from moireaug.engine.cpu.harmonics import cubic_weights
from moireaug.engine.cpu.lookup import NARROW_TAPS, WIDE_TAPS
from moireaug.engine.cpu.normal import TAIL_END_SIGMAS, integrals
from moireaug.engine.cpu.vectors import load, store
from moireaug.engine.cpu.view import BOX, SIGMA, fill_blurs, light_from

# limits of memory; with fewer phases than the budget asks for, weights are less exact
MAX_PHASES = 512
# at a few nodes, as in a frontal view, whose pixels may all lie where a weight has a kink
MAX_PHASES_OF_FEW_NODES = 8192
PHASE_MULTIPLE = 16  # of which the number of phases is a multiple


class Scratch(NamedTuple):
    """What the weights of a node are computed in, float64.

    Args:
        integral: (n,), what `normal.integrals` fills, `cubic_margin` steps beyond all light on both
            sides. light: ((2 radius + 1) phases / 2 + 1,), the light from each distance.
        total: (phases / 2 + 1,), the light from all cells.
    """

    integral: np.ndarray
    light: np.ndarray
    total: np.ndarray


@jit_in_place
def cubic_margin(far):
    """Return how many values beyond both ends of a line a cubic needs to move it by `far` steps."""
    return math.ceil(far) + 3


@jit_in_place
def _add_moved(out, sign, line, first, by):
    """Add sign times the values of a line from `first` + `by` steps on, interpolated by cubics."""
    whole = math.floor(by)
    cubic = cubic_weights(by - whole + 1)
    a, b, c, d = sign * cubic[0], sign * cubic[1], sign * cubic[2], sign * cubic[3]
    start = first + whole - 1
    for i in range(len(out)):
        at = start + i
        outer = a * load(line, at) + d * load(line, at + 3)
        store(out, i, out[i] + (outer + b * load(line, at + 1) + c * load(line, at + 2)))


@jit_in_place
def _fill_light(light, integral_line, box, width, sigma, phases):
    """Fill light (n,) with that from a subpixel 0, 1, ... phases away: the integral of the normal
    distribution function, differenced over box and width."""
    far, near = (box + width) / 2 * phases, (box - width) / 2 * phases
    seen = min(int(far + TAIL_END_SIGMAS * sigma * phases) + 2, len(light))
    zero = cubic_margin(far)
    line, lit = integral_line[: zero + seen + zero], light[:seen]
    integrals(line, zero, 1 / phases, sigma)
    fill(light, 0.0)
    _add_moved(lit, 1.0, line, zero, far)
    _add_moved(lit, -1.0, line, zero, near)
    _add_moved(lit, -1.0, line, zero, -near)
    _add_moved(lit, 1.0, line, zero, -far)
    for i in range(seen):
        lit[i] = max(lit[i], 0.0)  # rounding may leave it a digit below zero


@jit_in_place
def _add_two(total, light, middle):
    """Add the light of the cells `middle` before and behind."""
    for q in range(len(total)):
        total[q] += light[middle - q] + light[middle + q]


@jit_in_place
def _fill_phases(out, blur, width, radius, scratch):
    """Fill out (phases + 2, taps) with the tap weights at distances from -1/2 to 1/2 from the
    nearest cell's centre. Distance 0 is there twice, as the first tap changes there.

    blur: box and standard deviation, see `view.fill_blur`. width: of the subpixel, in cells.
    """
    box, sigma = blur[BOX], blur[SIGMA]
    phases, taps = out.shape[0] - 2, out.shape[1]
    half = phases // 2
    light, total = scratch.light[: (2 * radius + 1) * half + 1], scratch.total[: half + 1]
    _fill_light(light, scratch.integral, box, width, sigma, phases)
    guard = NEAREST_GUARD_SHARE * box
    for q in range(half + 1):
        total[q] = light[q] + guard
    for k in range(1, radius + 1):
        _add_two(total, light, k * phases)
    for q in range(half + 1):
        total[q] = 1 / total[q]
    for j in range(taps):
        k = j - taps // 2
        for q in range(half + 1):
            # a pixel q phases before the nearest cell's centre; as far behind, weights are mirrored
            at = abs(k) * phases + (q if k >= 0 else -q)
            share = np.float32(
                (light[at] + (guard if k == 0 else 0.0)) * total[q] if abs(k) <= radius else 0.0
            )
            out[half - q, j] = share
            out[half + 1 + q, taps - 1 - j] = share


@jit_in_place
def weights_per_node(phases, taps):
    """Return how many weights a node has along x, and along both axes; phases: (2,)."""
    along_x = (phases[0] + 2) * taps
    return along_x, along_x + (phases[1] + 2) * taps


@jit_in_place
def fill_node(out, blur, widths, radius, phases, taps, scratch):
    """Fill out (n,) with the tap weights of a node along x, and then along y.

    Args:
        blur: (axis, 2), from `view.fill_blur`. widths: (2,) of the subpixel, in cells.
        radius: see `exposure_records.Cell`. phases, taps: (2,) and an int, of the table.
    """
    n, _ = weights_per_node(phases, taps)
    along_x, along_y = out[:n], out[n:]
    _fill_phases(along_x.reshape(phases[0] + 2, taps), blur[0], widths[0], radius, scratch)
    _fill_phases(along_y.reshape(phases[1] + 2, taps), blur[1], widths[1], radius, scratch)


@jit_in_place
def _phases(blur, axis, max_error):
    """Return how many phases a table of weights needs along an axis, over blurs (n, axis, 2)."""
    most = MAX_PHASES_OF_FEW_NODES if len(blur) <= 4 else MAX_PHASES
    needed = 1.0
    for i in range(len(blur)):
        needed = max(needed, 1 / math.sqrt(max_error * blur[i, axis, BOX] * blur[i, axis, SIGMA]))
    return PHASE_MULTIPLE * min(math.ceil(needed / PHASE_MULTIPLE), most // PHASE_MULTIPLE)


@jit_in_place
def _taps(blur, widths, radius, min_light):
    """Return how many taps each axis needs, over blurs (n, axis, 2): NARROW_TAPS if no cell beyond
    them gives more than a share `min_light` of the light, else WIDE_TAPS."""
    for i in range(len(blur)):
        for axis in range(2):
            box, sigma, width = blur[i, axis, BOX], blur[i, axis, SIGMA], widths[axis]
            if radius > 1 and light_from(2.0, box, sigma, width) > min_light * box * width:
                return WIDE_TAPS
    return NARROW_TAPS


@jit
def weight_tables(us, vs, view, budget):
    """Return the tap weights on nodes of the photo, the phases of each kind along both axes,
    (kinds, 2) int64, and its taps along each axis, (kinds,) int64.

    The weights are (kinds, rows, n) float32: of the nodes of a row one after another, (phases + 2,
    taps) along x and then along y; see `fill_node`.

    view: a PixelView. budget: an `ErrorBudget`.
    """
    widths, radius = view.widths, view.cell.radius
    kinds, rows, cols = len(widths), len(vs), len(us)
    blur = np.empty((kinds, rows * cols, 2, 2), np.float64)
    phases, taps = np.empty((kinds, 2), np.int64), np.empty(kinds, np.int64)
    most, finest, farthest = 0, 0, radius + 0.5
    for kind in range(kinds):
        fill_blurs(blur[kind], us, vs, view, kind)
        for axis in range(2):
            phases[kind, axis] = _phases(blur[kind], axis, budget.phase_error)
            finest = max(finest, phases[kind, axis])
            farthest = max(farthest, widths[kind, axis] / 2)
        taps[kind] = _taps(blur[kind], widths[kind], radius, budget.cell_light)
        most = max(most, weights_per_node(phases[kind], taps[kind])[1])
    tables = np.empty((kinds, rows, cols * most), np.float32)
    distances = (2 * radius + 1) * finest // 2 + 1
    scratch = Scratch(
        np.empty(distances + 2 * cubic_margin(farthest * finest), np.float64),
        np.empty(distances, np.float64),
        np.empty(finest // 2 + 1, np.float64),
    )
    for kind in range(kinds):
        n = weights_per_node(phases[kind], taps[kind])[1]
        for r in range(rows):
            for c in range(cols):
                fill_node(
                    tables[kind, r, c * n : (c + 1) * n],
                    blur[kind, r * cols + c],
                    widths[kind],
                    radius,
                    phases[kind],
                    taps[kind],
                    scratch,
                )
    return tables, phases, taps


@jit_in_place
def blend(out, low, high, f):
    """Fill out (n,) with the values f of the way from one row of nodes to the next."""
    for i in range(len(out)):
        a = load(low, i)
        store(out, i, a + f * (load(high, i) - a))
