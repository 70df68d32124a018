"""The cells that a sensor pixel's light comes from, and their weights.

They change slowly over a photo: they are computed on a grid of nodes and interpolated linearly.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.compiling import inner, loop
from moireaug.engine.lookup import NARROW, WIDE
from moireaug.engine.shares import Scratch, beside, fill_node, sizes
from moireaug.engine.tables import integral
from moireaug.engine.vectors import peek, poke
from moireaug.engine.view import jacobian
from moireaug.exposure.content import TAIL

NARROWEST = 1e-12  # variance in cells
GRAIN = 16  # phases are a multiple of it
# of which there are at most so many; at a few nodes, as in a frontal view, whose pixels may all lie
# where a weight has a kink, at most FINEST
MOST_PHASES, FINEST = 512, 8192
SMOOTH = 4e-3  # error of a weight that is interpolated linearly between phases
FAINT = 1e-3  # of a pixel's light: cells that give less are not looked at


@inner
def by_lens(by_camera, u, v, camera, lens):
    """Return the Jacobian of the lens, given the camera's; see `exposure_records.Exposure`."""
    if lens.rectified != 0:
        return jacobian(u, v, lens)
    xu, xv, yu, yv = by_camera
    across, down = camera.scale_u / lens.scale_u, camera.scale_v / lens.scale_v
    return xu * across, xv * down, yu * across, yv * down


@inner
def moved(by_u, by_v, lens):
    """Return the standard deviation of the motion along one axis, in panel pixels, with a sign."""
    return by_u * lens.motion_x + by_v * lens.motion_y


@inner
def still(by_u, by_v, fill, lens_u, lens_v, lens):
    """Return the variance along one axis without motion, beside the box: squared panel pixels."""
    short = min(abs(by_u), abs(by_v)) * fill
    beside = lens.blur * lens.blur + lens.olpf * lens.olpf / 4
    return short * short / 12 + (lens_u * lens_u + lens_v * lens_v) * beside


@inner
def _spread(out, by_camera, by_lens_, camera, lens, period, width, skew, taps):
    """Do the same as `spreads` along one axis, along which a step to the next pixel's u and v goes
    by so many panel pixels."""
    (by_u, by_v), (lens_u, lens_v) = by_camera, by_lens_
    long = max(abs(by_u), abs(by_v)) * camera.fill / period
    moves = moved(lens_u, lens_v, lens)
    variance = still(by_u, by_v, camera.fill, lens_u, lens_v, lens) + moves * moves
    variance = variance / (period * period) + skew
    sigma = math.sqrt(variance + NARROWEST)
    reach = long / 2 + TAIL * sigma
    shrink = min(1.0, max(taps + 0.5 - width / 2, NARROWEST) / reach)
    out[0], out[1] = long * shrink, sigma * shrink
    return shrink < 1


@inner
def spreads(out, u, v, camera, lens, period, width, skew, taps):
    """Fill out (axis, 2) with the box and the standard deviation of the light along both axes, in
    cells, at a photo point; narrowed to what 2 `taps` + 1 cells hold, as `exposure.content.fitted`
    does. Return whether any was narrowed."""
    by_camera = jacobian(u, v, camera)
    (xu, xv, yu, yv), (lxu, lxv, lyu, lyv) = by_camera, by_lens(by_camera, u, v, camera, lens)
    x, lens_x, y, lens_y = (xu, xv), (lxu, lxv), (yu, yv), (lyu, lyv)
    in_x = _spread(out[0], x, lens_x, camera, lens, period[0], width[0], skew[0], taps)
    in_y = _spread(out[1], y, lens_y, camera, lens, period[1], width[1], skew[1], taps)
    return in_x or in_y


@inner
def _phases(spread, axis):
    """Return how many phases tables of weights need along an axis, over spreads (n, axis, 2)."""
    most = FINEST if len(spread) <= 4 else MOST_PHASES
    needed = 1.0
    for i in range(len(spread)):
        needed = max(needed, 1 / math.sqrt(SMOOTH * spread[i, axis, 0] * spread[i, axis, 1]))
    return GRAIN * min(math.ceil(needed / GRAIN), most // GRAIN)


@inner
def _cells(spread, widths, taps):
    """Return how many cells along each axis are looked at, over spreads (n, axis, 2): NARROW where
    none beyond matters."""
    for i in range(len(spread)):
        for axis in range(2):
            box, sigma, width = spread[i, axis, 0], spread[i, axis, 1], widths[axis]
            if taps > 1 and light_from(2.0, box, sigma, width) > FAINT * box * width:
                return WIDE
    return NARROW


@inner
def light_from(x, box, sigma, width):
    """Return the light from a subpixel at distance x, of all light that a box of 1 would see."""
    far, near = (box + width) / 2, (box - width) / 2
    seen = integral(x + far, sigma) - integral(x + near, sigma)
    return max(seen - integral(x - near, sigma) + integral(x - far, sigma), 0.0)


@inner
def fill_spreads(out, us, vs, camera, lens, period, widths, skew, taps):
    """Fill out (rows * cols, axis, 2) with the `spreads` at nodes of the photo."""
    for r in range(len(vs)):
        for c in range(len(us)):
            node = out[r * len(us) + c]
            spreads(node, us[c], vs[r], camera, lens, period, widths, skew, taps)


@loop
def weights(us, vs, camera, lens, cell, widths, skew):
    """Return the weights of cells on nodes of the photo, the phases of each kind along both axes,
    (kinds, 2) int64, and its cells along each axis, (kinds,) int64.

    The weights are (kinds, rows, n) float32: of the nodes of a row one after another, (phases + 2,
    cells) along x and then along y; see `shares.fill_node`.

    widths, skew: (kinds, 2), see `exposure_records.Exposure`.
    """
    kinds, rows, cols, taps = len(widths), len(vs), len(us), cell.radius
    spread = np.empty((kinds, rows * cols, 2, 2), np.float64)
    phases, cells = np.empty((kinds, 2), np.int64), np.empty(kinds, np.int64)
    most, finest, farthest = 0, 0, taps + 0.5
    for kind in range(kinds):
        fill_spreads(
            spread[kind], us, vs, camera, lens, cell.period[kind], widths[kind], skew[kind], taps
        )
        for axis in range(2):
            phases[kind, axis] = _phases(spread[kind], axis)
            finest = max(finest, phases[kind, axis])
            farthest = max(farthest, widths[kind, axis] / 2)
        cells[kind] = _cells(spread[kind], widths[kind], taps)
        most = max(most, sizes(phases[kind], cells[kind])[1])
    tables = np.empty((kinds, rows, cols * most), np.float32)
    distances = (2 * taps + 1) * finest // 2 + 1
    scratch = Scratch(
        np.empty(distances + 2 * beside(farthest * finest), np.float64),
        np.empty(distances, np.float64),
        np.empty(finest // 2 + 1, np.float64),
        np.empty(4, np.float64),
    )
    for kind in range(kinds):
        n = sizes(phases[kind], cells[kind])[1]
        for r in range(rows):
            for c in range(cols):
                fill_node(
                    tables[kind, r, c * n : (c + 1) * n],
                    spread[kind, r * cols + c],
                    widths[kind],
                    taps,
                    phases[kind],
                    cells[kind],
                    scratch,
                )
    return tables, phases, cells


@inner
def blend(out, low, high, f):
    """Fill out (n,) with the values f of the way from one row of nodes to the next."""
    for i in range(len(out)):
        a = peek(low, i)
        poke(out, i, a + f * (peek(high, i) - a))
