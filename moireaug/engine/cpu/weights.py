"""The tap weights of the cells that a sensor pixel's light comes from, as tables.

They change slowly over a photo: they are computed on a grid of nodes and interpolated linearly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu.compiling import inner, loop
from moireaug.engine.cpu.lookup import NARROW_TAPS, WIDE_TAPS
from moireaug.engine.cpu.normal import integral
from moireaug.engine.cpu.tap_weights import Scratch, cubic_margin, fill_node, weights_per_node
from moireaug.engine.cpu.vectors import peek, poke
from moireaug.engine.cpu.view import jacobian
from moireaug.engine.lower.budget import MAX_PHASES, MAX_PHASES_OF_FEW_NODES
from moireaug.exposure.footprint import MIN_BLUR_VARIANCE, TAIL_SIGMAS

PHASE_MULTIPLE = 16  # of which the number of phases is a multiple


class SubpixelSize(NamedTuple):
    """The size of one kind of subpixel.

    Args:
        period: (2,) int64, of its cell in panel pixels. width, added_variance: (2,) float64, in
            cells and squared cells, see `exposure_records.Exposure`.
    """

    period: np.ndarray
    width: np.ndarray
    added_variance: np.ndarray


@inner
def lens_jacobian(by_camera, u, v, camera, lens):
    """Return the Jacobian of a lens at a photo point, as `view.jacobian` does; by_camera: the
    camera's. For camera and lens, see `exposure_records.Exposure`."""
    if lens.rectified != 0:
        return jacobian(u, v, lens)
    xu, xv, yu, yv = by_camera
    across, down = camera.scale_u / lens.scale_u, camera.scale_v / lens.scale_v
    return xu * across, xv * down, yu * across, yv * down


@inner
def motion_sigma(by_u, by_v, lens):
    """Return the standard deviation of motion blur along one axis, in panel pixels, with a sign."""
    return by_u * lens.motion_x + by_v * lens.motion_y


@inner
def still_variance(by_u, by_v, fill, lens_u, lens_v, lens):
    """Return the variance of the blur along one axis without its box and without motion, in squared
    panel pixels."""
    short = min(abs(by_u), abs(by_v)) * fill
    of_lens = lens.blur * lens.blur + lens.olpf * lens.olpf / 4
    return short * short / 12 + (lens_u * lens_u + lens_v * lens_v) * of_lens


@inner
def _fill_axis(out, steps, camera, lens, subpixel, axis, radius):
    """Do the same as `fill_blur` along one axis.

    steps: panel pixels per sensor pixel along u and v, by the camera's Jacobian and by the lens's.
    """
    by_u, by_v, lens_u, lens_v = steps
    period = subpixel.period[axis]
    long = max(abs(by_u), abs(by_v)) * camera.fill / period
    moves = motion_sigma(lens_u, lens_v, lens)
    variance = still_variance(by_u, by_v, camera.fill, lens_u, lens_v, lens) + moves * moves
    variance = variance / (period * period) + subpixel.added_variance[axis]
    sigma = math.sqrt(variance + MIN_BLUR_VARIANCE)
    reach = long / 2 + TAIL_SIGMAS * sigma
    room = max(radius + 0.5 - subpixel.width[axis] / 2, MIN_BLUR_VARIANCE)
    shrink = min(1.0, room / reach)
    out[0], out[1] = long * shrink, sigma * shrink
    return shrink < 1


@inner
def fill_blur(out, u, v, camera, lens, subpixel, radius):
    """Fill out (axis, 2) with the blur at a photo point: the box and the standard deviation along
    both axes, in cells, narrowed to what 2 `radius` + 1 cells hold, as `Footprint.fitted`
    does. Return whether any was narrowed.

    camera, lens: see `exposure_records.Exposure`. subpixel: a SubpixelSize.
    """
    by_camera = jacobian(u, v, camera)
    (xu, xv, yu, yv), (lxu, lxv, lyu, lyv) = by_camera, lens_jacobian(by_camera, u, v, camera, lens)
    in_x = _fill_axis(out[0], (xu, xv, lxu, lxv), camera, lens, subpixel, 0, radius)
    in_y = _fill_axis(out[1], (yu, yv, lyu, lyv), camera, lens, subpixel, 1, radius)
    return in_x or in_y


@inner
def _phases(blur, axis, max_error):
    """Return how many phases a table of weights needs along an axis, over blurs (n, axis, 2)."""
    most = MAX_PHASES_OF_FEW_NODES if len(blur) <= 4 else MAX_PHASES
    needed = 1.0
    for i in range(len(blur)):
        needed = max(needed, 1 / math.sqrt(max_error * blur[i, axis, 0] * blur[i, axis, 1]))
    return PHASE_MULTIPLE * min(math.ceil(needed / PHASE_MULTIPLE), most // PHASE_MULTIPLE)


@inner
def _taps(blur, widths, radius, min_light):
    """Return how many taps each axis needs, over blurs (n, axis, 2): NARROW_TAPS if no cell beyond
    them gives more than a share `min_light` of the light, else WIDE_TAPS."""
    for i in range(len(blur)):
        for axis in range(2):
            box, sigma, width = blur[i, axis, 0], blur[i, axis, 1], widths[axis]
            if radius > 1 and light_from(2.0, box, sigma, width) > min_light * box * width:
                return WIDE_TAPS
    return NARROW_TAPS


@inner
def light_from(x, box, sigma, width):
    """Return the light from a subpixel at distance x, of all light that a box of 1 would see."""
    far, near = (box + width) / 2, (box - width) / 2
    seen = integral(x + far, sigma) - integral(x + near, sigma)
    return max(seen - integral(x - near, sigma) + integral(x - far, sigma), 0.0)


@inner
def fill_blurs(out, us, vs, camera, lens, subpixel, radius):
    """Fill out (rows * cols, axis, 2) with the blur at nodes of the photo; see `fill_blur`."""
    for r in range(len(vs)):
        for c in range(len(us)):
            node = out[r * len(us) + c]
            fill_blur(node, us[c], vs[r], camera, lens, subpixel, radius)


@loop
def tap_weight_tables(us, vs, camera, lens, cell, widths, added_variance, budget):
    """Return the tap weights on nodes of the photo, the phases of each kind along both axes,
    (kinds, 2) int64, and its taps along each axis, (kinds,) int64.

    The weights are (kinds, rows, n) float32: of the nodes of a row one after another, (phases + 2,
    taps) along x and then along y; see `tap_weights.fill_node`.

    widths, added_variance: (kinds, 2), see `exposure_records.Exposure`. budget: an `ErrorBudget`.
    """
    kinds, rows, cols, radius = len(widths), len(vs), len(us), cell.radius
    blur = np.empty((kinds, rows * cols, 2, 2), np.float64)
    phases, taps = np.empty((kinds, 2), np.int64), np.empty(kinds, np.int64)
    most, finest, farthest = 0, 0, radius + 0.5
    for kind in range(kinds):
        subpixel = SubpixelSize(cell.period[kind], widths[kind], added_variance[kind])
        fill_blurs(blur[kind], us, vs, camera, lens, subpixel, radius)
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
        np.empty(4, np.float64),
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


@inner
def blend(out, low, high, f):
    """Fill out (n,) with the values f of the way from one row of nodes to the next."""
    for i in range(len(out)):
        a = peek(low, i)
        poke(out, i, a + f * (peek(high, i) - a))
