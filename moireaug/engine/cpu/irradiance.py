"""The panel's irradiance on a row of a plane's pixels, subpixel by subpixel of the panel's cell.

Subpixels are sorted, so that what neighbours share is computed once.
"""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import harmonics, lookup, rows
from moireaug.engine.cpu.coarse_grid import bracket
from moireaug.engine.cpu.compiling import fill, jit_inlined
from moireaug.engine.cpu.panel import margin
from moireaug.engine.cpu.records import TapWeights
from moireaug.engine.cpu.rows import X, Y
from moireaug.engine.cpu.tap_weights import weights_per_node
from moireaug.engine.cpu.view import look

ZERO = np.float32(0)


@jit_inlined
def _locate_along_x(row, image, kind):
    """Fill where the pixels look along x in the cells of a kind, and the waves there."""
    offset, nearest = row.floats[rows.CELL_OFFSET_X], row.ints[rows.NEAREST_CELL_X]
    period = image.cell.period[kind, 0]
    cells = period, image.panel_size[1], image.cell.radius
    lookup.split_into_cells(offset, nearest, row.position[X], cells, 0.0)
    harmonics.fill_waves(row.wave[rows.COS_X], row.wave[rows.SIN_X], offset)


@jit_inlined
def _locate_along_y(row, image, i):
    """Fill where the pixels look along y about subpixel i, and the waves there."""
    offset, nearest = row.floats[rows.CELL_OFFSET_Y], row.ints[rows.NEAREST_CELL_Y]
    cell, centre = image.cell, image.cell.centre[i, 1]
    period = cell.period[cell.subpixel_kind[i], 1]
    cells = period, image.panel_size[0], cell.radius
    lookup.split_into_cells(offset, nearest, row.position[Y], cells, centre)
    harmonics.fill_waves(row.wave_y[rows.COS_Y], row.wave_y[rows.SIN_Y], offset)


@jit_inlined
def _tap_weights(work, grid, plane, kind):
    """Return the pixels' TapWeights along the axis for which `lookup.locate_taps` was last
    called."""
    row, node_share = work.row, work.layout.node_share[plane]
    to_next = np.int32(weights_per_node(grid.phases[kind], grid.taps[kind])[1])
    index, phase_share = row.ints[rows.WEIGHT_INDEX], row.floats[rows.PHASE_SHARE]
    return TapWeights(row.weights[kind], to_next, index, phase_share, node_share)


@jit_inlined
def _fill_weights_along_y(work, grid, plane, kind):
    """Fill the tap weights of the pixels along y."""
    row, start = work.row, work.layout.weight_start[kind, 1, plane]
    index, phase_share = row.ints[rows.WEIGHT_INDEX], row.floats[rows.PHASE_SHARE]
    offset, nearest = row.floats[rows.CELL_OFFSET_Y], row.ints[rows.NEAREST_CELL_Y]
    first, phases, taps = row.ints[rows.FIRST_CELL_Y], grid.phases[kind, 1], grid.taps[kind]
    lookup.locate_taps(first, index, phase_share, offset, nearest, start, phases, taps)
    lookup.fill_weights(row.weights_y, _tap_weights(work, grid, plane, kind), taps)


@jit_inlined
def _add_up_harmonics(row, grid, sites, plane, kind, v):
    """Fill the harmonics along x of a kind's light at the pixels, those along y added up."""
    node, t = bracket(v, sites.rows[0], grid.step_v, grid.lines.shape[1], 3)
    cubic = harmonics.cubic_weights32(t)
    lines, orders = grid.lines[sites.col[plane], node : node + 4], row.orders[kind]
    even, odd = row.wave[rows.EVEN, :orders], row.wave[rows.ODD, :orders]
    in_phase, quadrature = row.wave[rows.IN_PHASE, :orders], row.wave[rows.QUADRATURE, :orders]
    cos_x, sin_x = row.wave[rows.COS_X], row.wave[rows.SIN_X]
    cos_y, sin_y = row.wave_y[rows.COS_Y], row.wave_y[rows.SIN_Y]
    harmonics.row_amplitudes(even, odd, grid.terms, kind, lines, cubic, cos_y, sin_y)
    harmonics.rotate_phase(in_phase, quadrature, even, odd, cos_x, sin_x)


@jit_inlined
def _origin(cell, i, stride):
    """Return the index of subpixel i of cell (0, 0) on the flattened panel, rows `stride` apart."""
    period = cell.period[cell.subpixel_kind[i], 0]
    first = (margin(cell, 1) + cell.pixel[i, 1]) * stride + margin(cell, 0) // period
    return np.int32(first + cell.pixel[i, 0] * (stride // period))


@jit_inlined
def _locate_content(work, stride, image, plane, i):
    """Fill the index of the first cell that each pixel sees of subpixel i, on its colour's
    flattened panel; return the pixels' TapWeights along x."""
    row, cell, grid = work.row, image.cell, image.grid
    kind, period = cell.subpixel_kind[i], cell.period[cell.subpixel_kind[i]]
    start, first = work.layout.weight_start[kind, 0, plane], row.ints[rows.FIRST_CELL_X]
    index, phase_share = row.ints[rows.WEIGHT_INDEX], row.floats[rows.PHASE_SHARE]
    offset, nearest = row.floats[rows.CELL_OFFSET_X], row.ints[rows.NEAREST_CELL_X]
    cells, centre = (period[0], image.panel_size[1], cell.radius), cell.centre[i, 0]
    lookup.split_into_cells(offset, nearest, row.position[X], cells, centre)
    lookup.locate_taps(
        first, index, phase_share, offset, nearest, start, grid.phases[kind, 0], grid.taps[kind]
    )
    down, origin = np.int32(period[1] * stride), _origin(cell, i, stride)
    lookup.fill_base(row.ints[rows.BASE_INDEX], first, row.ints[rows.FIRST_CELL_Y], down, origin)
    return _tap_weights(work, grid, plane, kind)


@jit_inlined
def _fill_modulation(row, cell, i):
    """Fill the modulation of subpixel i's content."""
    orders = row.orders[cell.subpixel_kind[i]]
    in_phase, quadrature = row.wave[rows.IN_PHASE, :orders], row.wave[rows.QUADRATURE, :orders]
    modulation = row.floats[rows.MODULATION]
    harmonics.fill_modulation(modulation, in_phase, quadrature, row.cos[i], row.sin[i])


@jit_inlined
def _locate_subpixel(work, stride, image, plane, v, i, before):
    """Fill what the pixels on row v need of subpixel i, and subpixel `before`, if any, has not
    filled already; return their TapWeights along x."""
    row, cell = work.row, image.cell
    kind, is_first = cell.subpixel_kind[i], before < 0
    if is_first or cell.period[kind, 0] != cell.period[cell.subpixel_kind[before], 0]:
        _locate_along_x(row, image, kind)
    if is_first or cell.y_group[i] != cell.y_group[before]:
        _locate_along_y(row, image, i)
    if is_first or cell.kind_y_group[i] != cell.kind_y_group[before]:
        _fill_weights_along_y(work, image.grid, plane, kind)
        _add_up_harmonics(row, image.grid, image.sites, plane, kind, v)
    _fill_modulation(row, cell, i)
    return _locate_content(work, stride, image, plane, i)


@jit_inlined
def panel_irradiance(work, panel, image, plane, v):
    """Fill the row's irradiance with the light that a plane's pixels see on row v, in each colour
    that the plane needs.

    Args:
        work: a record of the `layout` and the `row` of `rows`.
        panel: as in `full.expose_rows`.
        image: see `records.Image`.
    """
    row, cell, taps = work.row, image.cell, image.grid.taps
    look(row.position[X], row.position[Y], work.layout.u[plane], v, image.camera)
    fill(row.irradiance.reshape(-1), ZERO)
    stride = panel.shape[2]
    pixels = panel.reshape(3, panel.shape[1] * stride)
    before = -1
    for i in range(len(cell.channel)):
        colour, kind = cell.channel[i], cell.subpixel_kind[i]
        if not work.layout.needs_colour[plane, colour]:
            continue
        weights = _locate_subpixel(work, stride, image, plane, v, i, before)
        before = i
        content, base = row.floats[rows.CONTENT], row.ints[rows.BASE_INDEX]
        down = np.int32(cell.period[kind, 1] * stride)
        shown, weights_y = pixels[colour], row.weights_y
        lookup.content(content, shown, base, down, weights, weights_y, taps[kind])
        harmonics.add_product(row.irradiance[colour], content, row.floats[rows.MODULATION])


@jit_inlined
def panel_irradiance_back(work, panel_grad, image, plane, v):
    """Add the gradient in the panel, of its shape, from that in a plane's irradiance on row v,
    which the row holds; work: as in `panel_irradiance`."""
    row, cell, taps = work.row, image.cell, image.grid.taps
    look(row.position[X], row.position[Y], work.layout.u[plane], v, image.camera)
    stride = panel_grad.shape[2]
    pixels = panel_grad.reshape(3, panel_grad.shape[1] * stride)
    before = -1
    for i in range(len(cell.channel)):
        colour, kind = cell.channel[i], cell.subpixel_kind[i]
        if not work.layout.needs_colour[plane, colour]:
            continue
        weights = _locate_subpixel(work, stride, image, plane, v, i, before)
        before = i
        lookup.fill_weights(row.weights_x, weights, taps[kind])
        content, base = row.floats[rows.CONTENT], row.ints[rows.BASE_INDEX]
        fill(content, ZERO)
        harmonics.add_product(content, row.irradiance[colour], row.floats[rows.MODULATION])
        down = np.int32(cell.period[kind, 1] * stride)
        shown_grad, weights_x, weights_y = pixels[colour], row.weights_x, row.weights_y
        lookup.content_back(shown_grad, content, base, down, weights_x, weights_y, taps[kind])
