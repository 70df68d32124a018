"""The panel's irradiance on a row of a plane's pixels, subpixel by subpixel of the panel's cell.

Subpixels are sorted, so that what neighbours share is computed once.
"""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import harmonics, lookup
from moireaug.engine.cpu.coarse_grid import bracket
from moireaug.engine.cpu.compiling import fill, jit_inlined
from moireaug.engine.cpu.panel import margin
from moireaug.engine.cpu.records import TapWeights
from moireaug.engine.cpu.tap_weights import weights_per_node
from moireaug.engine.cpu.view import look

ZERO = np.float32(0)


@jit_inlined
def _cells(image, kind, axis):
    """Return what `lookup.split_into_cells` takes of a kind's cells along x (0) or y (1)."""
    return image.cell.period[kind, axis], image.panel_size[1 - axis], image.cell.radius


@jit_inlined
def _fill_waves(along, position, cells, centre):
    """Fill where the pixels look along an axis in cells about a centre, and the waves there."""
    lookup.split_into_cells(along.offset, along.nearest, position, cells, centre)
    harmonics.fill_waves(along.cos, along.sin, along.offset)


@jit_inlined
def _tap_weights(work, along, grid, plane, kind, axis):
    """Fill the first cell that each pixel sees along x (0) or y (1); return their TapWeights, until
    those along another axis are asked for."""
    row, layout, taps = work.row, work.layout, grid.taps[kind]
    start, phases = layout.weight_start[kind, axis, plane], grid.phases[kind, axis]
    lookup.locate_taps(along, row.weight_index, row.phase_share, start, phases, taps)
    to_next = np.int32(weights_per_node(grid.phases[kind], taps)[1])
    node_share = layout.node_share[plane]
    return TapWeights(row.weights[kind], to_next, row.weight_index, row.phase_share, node_share)


@jit_inlined
def _add_up_harmonics(row, grid, sites, plane, kind, v):
    """Fill the harmonics along x of a kind's light at the pixels, those along y added up."""
    node, t = bracket(v, sites.rows[0], grid.step_v, grid.lines.shape[1], 3)
    cubic, orders = harmonics.cubic_weights32(t), row.orders[kind]
    lines = grid.lines[sites.col[plane], node : node + 4]
    even, odd, x, y = row.even[:orders], row.odd[:orders], row.along_x, row.along_y
    in_phase, quadrature = row.in_phase[:orders], row.quadrature[:orders]
    harmonics.row_amplitudes(even, odd, grid.terms, kind, lines, cubic, y.cos, y.sin)
    harmonics.rotate_phase(in_phase, quadrature, even, odd, x.cos, x.sin)


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
    row, cell, kind = work.row, image.cell, image.cell.subpixel_kind[i]
    x, y, cells, centre = row.along_x, row.along_y, _cells(image, kind, 0), cell.centre[i, 0]
    lookup.split_into_cells(x.offset, x.nearest, row.position.x, cells, centre)
    weights = _tap_weights(work, x, image.grid, plane, kind, 0)
    down, origin = np.int32(cell.period[kind, 1] * stride), _origin(cell, i, stride)
    lookup.fill_base(row.base, x.first, y.first, down, origin)
    return weights


@jit_inlined
def _fill_modulation(row, cell, i):
    """Fill the modulation of subpixel i's content."""
    orders, cos, sin = row.orders[cell.subpixel_kind[i]], row.centre_cos[i], row.centre_sin[i]
    in_phase, quadrature = row.in_phase[:orders], row.quadrature[:orders]
    harmonics.fill_modulation(row.modulation, in_phase, quadrature, cos, sin)


@jit_inlined
def _locate_subpixel(work, stride, image, plane, v, i, before):
    """Fill what the pixels on row v need of subpixel i, and subpixel `before`, if any, has not
    filled already; return their TapWeights along x."""
    row, cell, grid = work.row, image.cell, image.grid
    x, y, position = row.along_x, row.along_y, row.position
    kind, is_first = cell.subpixel_kind[i], before < 0
    if is_first or cell.period[kind, 0] != cell.period[cell.subpixel_kind[before], 0]:
        _fill_waves(x, position.x, _cells(image, kind, 0), 0.0)
    if is_first or cell.y_group[i] != cell.y_group[before]:
        _fill_waves(y, position.y, _cells(image, kind, 1), cell.centre[i, 1])
    if is_first or cell.kind_y_group[i] != cell.kind_y_group[before]:
        weights = _tap_weights(work, y, grid, plane, kind, 1)
        lookup.fill_weights(row.weights_y, weights, grid.taps[kind])
        _add_up_harmonics(row, grid, image.sites, plane, kind, v)
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
    look(row.position.x, row.position.y, work.layout.u[plane], v, image.camera)
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
        content, shown, down = row.content, pixels[colour], np.int32(cell.period[kind, 1] * stride)
        lookup.content(content, shown, row.base, down, weights, row.weights_y, taps[kind])
        harmonics.add_product(row.irradiance[colour], content, row.modulation)


@jit_inlined
def panel_irradiance_back(work, panel_grad, image, plane, v):
    """Add the gradient in the panel, of its shape, from that in a plane's irradiance on row v,
    which the row holds; work: as in `panel_irradiance`."""
    row, cell, taps = work.row, image.cell, image.grid.taps
    look(row.position.x, row.position.y, work.layout.u[plane], v, image.camera)
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
        content, grad, down = row.content, pixels[colour], np.int32(cell.period[kind, 1] * stride)
        fill(content, ZERO)
        harmonics.add_product(content, row.irradiance[colour], row.modulation)
        across, below = row.weights_x, row.weights_y
        lookup.content_back(grad, content, row.base, down, across, below, taps[kind])
