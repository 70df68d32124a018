"""The panel's light on a row of a plane's pixels, one subpixel of the panel's cell after another.

Subpixels are sorted, so that what neighbours share is computed once.
"""

from __future__ import annotations

import numpy as np

from moireaug.engine import harmonics, lookup
from moireaug.engine.compiling import fill, inner, part
from moireaug.engine.nodes import bracket
from moireaug.engine.panel import margin
from moireaug.engine.rows import (
    BASE,
    BESIDE,
    BETWEEN,
    CONTENT,
    COS_X,
    COS_Y,
    EVEN,
    FIRST_X,
    FIRST_Y,
    HERE,
    NEAREST_X,
    NEAREST_Y,
    ODD,
    PAST_X,
    PAST_Y,
    PLACE,
    SIN_X,
    SIN_Y,
    THROUGH,
    X,
    Y,
)
from moireaug.engine.shares import sizes
from moireaug.engine.view import look

ZERO = np.float32(0)


@inner
def _split(past, nearest, at, centre, period, size, radius):
    """Split panel coordinates into cells and the rest, as `lookup.cells` does, no farther from a
    panel of `size` pixels than `radius` cells around it see."""
    cells = (size + period - 1) // period
    lookup.cells(past, nearest, at, centre, float(period), -radius - 1.0, float(cells + radius))


@part
def _aim_along_x(row, size, cell, kind):
    """Fill where along x the pixels look in the cells of a kind, and the waves there."""
    past, period = row.line[PAST_X], cell.period[kind, 0]
    _split(past, row.whole[NEAREST_X], row.at[X], 0.0, period, size[1], cell.radius)
    harmonics.waves(row.wave[COS_X], row.wave[SIN_X], past)


@part
def _aim_along_y(row, size, cell, i):
    """Fill where along y the pixels look about subpixel i, and the waves there."""
    past, period = row.line[PAST_Y], cell.period[cell.kind[i], 1]
    _split(past, row.whole[NEAREST_Y], row.at[Y], cell.centre[i, 1], period, size[0], cell.radius)
    harmonics.waves(row.of_y[COS_Y], row.of_y[SIN_Y], past)


@part
def _to_next(nodes, kind):
    """Return how many weights lie between a node's and the next one's."""
    return np.int32(sizes(nodes.phases[kind], nodes.cells[kind])[1])


@part
def _weigh_rows_of_cells(row, nodes, places, plane, kind):
    """Fill the weights of the rows of cells that the pixels look at."""
    cells, begin = nodes.cells[kind], places.column[kind, 1, plane]
    place, between = row.whole[PLACE], row.line[BETWEEN]
    past, nearest = row.line[PAST_Y], row.whole[NEAREST_Y]
    lookup.windows(
        row.whole[FIRST_Y], place, between, past, nearest, begin, nodes.phases[kind, 1], cells
    )
    lookup.down(
        row.of_rows, row.weights[kind], _to_next(nodes, kind), place, between, places.share[plane],
        cells,
    )  # fmt: skip


@part
def _add_up_harmonics(row, nodes, sites, plane, kind, v):
    """Fill the harmonics along x of a kind's light at the pixels, those along y added up."""
    node, t = bracket(v, sites.rows[0], nodes.step_v, nodes.lines.shape[1], 3)
    harmonics.lagrange(row.weight, t)
    lines, orders = nodes.lines[sites.col[plane], node : node + 4], row.orders[kind]
    even, odd = row.wave[EVEN, :orders], row.wave[ODD, :orders]
    here, beside = row.wave[HERE, :orders], row.wave[BESIDE, :orders]
    harmonics.across(
        even, odd, nodes.terms, kind, lines, row.weight, row.of_y[COS_Y], row.of_y[SIN_Y]
    )
    harmonics.turn(here, beside, even, odd, row.wave[COS_X], row.wave[SIN_X])


@part
def _origin(cell, i, stride):
    """Return where subpixel i of cell (0, 0) lies on the flattened panel, rows `stride` apart."""
    period = cell.period[cell.kind[i], 0]
    first = (margin(cell, 1) + cell.pixel[i, 1]) * stride + margin(cell, 0) // period
    return np.int32(first + cell.pixel[i, 0] * (stride // period))


@part
def _find_content(row, pixels, stride, size, cell, nodes, places, plane, i):
    """Fill the content of subpixel i's cells; pixels: the flattened panel of its colour."""
    kind, content, base = cell.kind[i], row.line[CONTENT], row.whole[BASE]
    cells, begin = nodes.cells[kind], places.column[kind, 0, plane]
    place, between, first = row.whole[PLACE], row.line[BETWEEN], row.whole[FIRST_X]
    past, nearest, period = row.line[PAST_X], row.whole[NEAREST_X], cell.period[kind]
    _split(past, nearest, row.at[X], cell.centre[i, 0], period[0], size[1], cell.radius)
    lookup.windows(first, place, between, past, nearest, begin, nodes.phases[kind, 0], cells)
    down = np.int32(period[1] * stride)
    lookup.base_of(base, first, row.whole[FIRST_Y], down, _origin(cell, i, stride))
    lookup.content(
        content, pixels, base, down, row.weights[kind], _to_next(nodes, kind), place, between,
        places.share[plane], row.of_rows, cells, cell.radius,
    )  # fmt: skip


@part
def _add_subpixel(row, pixels, stride, size, cell, nodes, places, plane, i):
    """Add the light of subpixel i to the row's glow."""
    colour, orders = cell.channel[i], row.orders[cell.kind[i]]
    _find_content(row, pixels[colour], stride, size, cell, nodes, places, plane, i)
    here, beside = row.wave[HERE, :orders], row.wave[BESIDE, :orders]
    harmonics.shine(
        row.glow[colour], row.line[CONTENT], here, beside, row.cos[i], row.sin[i],
        row.line[THROUGH],
    )  # fmt: skip


@part
def glow(row, panel, size, camera, cell, nodes, sites, places, plane, v):
    """Fill the row's glow with the light that a plane's pixels see on row v, in each colour that is
    asked for; arguments as in `expose.expose`."""
    look(row.at[X], row.at[Y], places.u[plane], v, camera)
    fill(row.glow.reshape(-1), ZERO)
    stride = panel.shape[2]
    pixels = panel.reshape(3, panel.shape[1] * stride)
    held_period, held_height, held_row = -1, -1, -1
    for i in range(len(cell.channel)):
        kind = cell.kind[i]
        if not places.asked[plane, cell.channel[i]]:
            continue
        if cell.period[kind, 0] != held_period:
            held_period = cell.period[kind, 0]
            _aim_along_x(row, size, cell, kind)
        if cell.height[i] != held_height:
            held_height = cell.height[i]
            _aim_along_y(row, size, cell, i)
        if cell.row[i] != held_row:
            held_row = cell.row[i]
            _weigh_rows_of_cells(row, nodes, places, plane, kind)
            _add_up_harmonics(row, nodes, sites, plane, kind, v)
        _add_subpixel(row, pixels, stride, size, cell, nodes, places, plane, i)
