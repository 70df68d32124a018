"""The panel's irradiance on a row of a plane's pixels, subpixel by subpixel of the panel's cell.

Subpixels are sorted, so that what neighbours share is computed once.
"""

from __future__ import annotations

import numpy as np

from moireaug.engine.cpu import harmonics, lookup
from moireaug.engine.cpu.compiling import fill, inner, part
from moireaug.engine.cpu.nodes import bracket
from moireaug.engine.cpu.panel import margin
from moireaug.engine.cpu.records import TapWeights
from moireaug.engine.cpu.rows import (
    BASE_INDEX,
    CELL_OFFSET_X,
    CELL_OFFSET_Y,
    CONTENT,
    COS_X,
    COS_Y,
    EVEN,
    FIRST_CELL_X,
    FIRST_CELL_Y,
    IN_PHASE,
    MODULATION,
    NEAREST_CELL_X,
    NEAREST_CELL_Y,
    ODD,
    PHASE_SHARE,
    QUADRATURE,
    SIN_X,
    SIN_Y,
    WEIGHT_INDEX,
    X,
    Y,
)
from moireaug.engine.cpu.tap_weights import weights_per_node
from moireaug.engine.cpu.view import look

ZERO = np.float32(0)


@inner
def _split(offset, nearest, position, centre, period, size, radius):
    """Split panel coordinates into cells and offsets, as `lookup.split_into_cells` does, no farther
    from a panel of `size` pixels than `radius` cells around it see."""
    cells, low = (size + period - 1) // period, -radius - 1.0
    high = float(cells + radius)
    lookup.split_into_cells(offset, nearest, position, centre, float(period), low, high)


@part
def _locate_along_x(row, size, cell, kind):
    """Fill where the pixels look along x in the cells of a kind, and the waves there."""
    offset, period = row.floats[CELL_OFFSET_X], cell.period[kind, 0]
    _split(offset, row.ints[NEAREST_CELL_X], row.position[X], 0.0, period, size[1], cell.radius)
    harmonics.fill_waves(row.wave[COS_X], row.wave[SIN_X], offset)


@part
def _locate_along_y(row, size, cell, i):
    """Fill where the pixels look along y about subpixel i, and the waves there."""
    offset, nearest = row.floats[CELL_OFFSET_Y], row.ints[NEAREST_CELL_Y]
    period, centre = cell.period[cell.kind[i], 1], cell.centre[i, 1]
    _split(offset, nearest, row.position[Y], centre, period, size[0], cell.radius)
    harmonics.fill_waves(row.wave_y[COS_Y], row.wave_y[SIN_Y], offset)


@part
def _tap_weights(work, nodes, plane, kind):
    """Return the pixels' TapWeights along the axis for which `lookup.locate_taps` was last
    called."""
    row, node_share = work.row, work.places.node_share[plane]
    to_next = np.int32(weights_per_node(nodes.phases[kind], nodes.taps[kind])[1])
    index, phase_share = row.ints[WEIGHT_INDEX], row.floats[PHASE_SHARE]
    return TapWeights(row.weights[kind], to_next, index, phase_share, node_share)


@part
def _fill_weights_along_y(work, nodes, plane, kind):
    """Fill the tap weights of the pixels along y."""
    row, start = work.row, work.places.weight_start[kind, 1, plane]
    index, phase_share = row.ints[WEIGHT_INDEX], row.floats[PHASE_SHARE]
    offset, nearest = row.floats[CELL_OFFSET_Y], row.ints[NEAREST_CELL_Y]
    first, phases, taps = row.ints[FIRST_CELL_Y], nodes.phases[kind, 1], nodes.taps[kind]
    lookup.locate_taps(first, index, phase_share, offset, nearest, start, phases, taps)
    lookup.fill_weights(row.weights_y, _tap_weights(work, nodes, plane, kind), taps)


@part
def _add_up_harmonics(row, nodes, sites, plane, kind, v):
    """Fill the harmonics along x of a kind's light at the pixels, those along y added up."""
    node, t = bracket(v, sites.rows[0], nodes.step_v, nodes.lines.shape[1], 3)
    harmonics.lagrange(row.cubic, t)
    lines, orders = nodes.lines[sites.col[plane], node : node + 4], row.orders[kind]
    even, odd = row.wave[EVEN, :orders], row.wave[ODD, :orders]
    in_phase, quadrature = row.wave[IN_PHASE, :orders], row.wave[QUADRATURE, :orders]
    cos_y, sin_y = row.wave_y[COS_Y], row.wave_y[SIN_Y]
    harmonics.row_amplitudes(even, odd, nodes.terms, kind, lines, row.cubic, cos_y, sin_y)
    harmonics.rotate_phase(in_phase, quadrature, even, odd, row.wave[COS_X], row.wave[SIN_X])


@part
def _origin(cell, i, stride):
    """Return the index of subpixel i of cell (0, 0) on the flattened panel, rows `stride` apart."""
    period = cell.period[cell.kind[i], 0]
    first = (margin(cell, 1) + cell.pixel[i, 1]) * stride + margin(cell, 0) // period
    return np.int32(first + cell.pixel[i, 0] * (stride // period))


@part
def _fill_content(work, pixels, stride, size, image, plane, i):
    """Fill the content of subpixel i's cells; pixels: the flattened panel of its colour."""
    row, cell, nodes = work.row, image.cell, image.nodes
    kind, base = cell.kind[i], row.ints[BASE_INDEX]
    taps, start = nodes.taps[kind], work.places.weight_start[kind, 0, plane]
    index, phase_share, first = (
        row.ints[WEIGHT_INDEX],
        row.floats[PHASE_SHARE],
        row.ints[FIRST_CELL_X],
    )
    offset, nearest, period = row.floats[CELL_OFFSET_X], row.ints[NEAREST_CELL_X], cell.period[kind]
    _split(offset, nearest, row.position[X], cell.centre[i, 0], period[0], size[1], cell.radius)
    lookup.locate_taps(
        first, index, phase_share, offset, nearest, start, nodes.phases[kind, 0], taps
    )
    down = np.int32(period[1] * stride)
    lookup.fill_base(base, first, row.ints[FIRST_CELL_Y], down, _origin(cell, i, stride))
    weights = _tap_weights(work, nodes, plane, kind)
    content = row.floats[CONTENT]
    lookup.content(content, pixels, base, down, weights, row.weights_y, taps, cell.radius)


@part
def _add_subpixel(work, pixels, stride, size, image, plane, i):
    """Add the light of subpixel i to the row's irradiance."""
    row, cell = work.row, image.cell
    colour, orders = cell.channel[i], row.orders[cell.kind[i]]
    _fill_content(work, pixels[colour], stride, size, image, plane, i)
    in_phase, quadrature = row.wave[IN_PHASE, :orders], row.wave[QUADRATURE, :orders]
    light, content, modulation = row.irradiance[colour], row.floats[CONTENT], row.floats[MODULATION]
    harmonics.modulate(light, content, in_phase, quadrature, row.cos[i], row.sin[i], modulation)


@part
def panel_irradiance(work, panel, size, image, plane, v):
    """Fill the row's irradiance with the light that a plane's pixels see on row v, in each colour
    that the plane needs.

    Args:
        work: a record of the `places` and the `row` of `rows`. panel, size: as in `expose.expose`.
        image: see `exposure_records.FullImage` or `binned_records.BinnedImage`.
    """
    row, cell, nodes = work.row, image.cell, image.nodes
    look(row.position[X], row.position[Y], work.places.u[plane], v, image.camera)
    fill(row.irradiance.reshape(-1), ZERO)
    stride = panel.shape[2]
    pixels = panel.reshape(3, panel.shape[1] * stride)
    last_period, last_height, last_row = -1, -1, -1
    for i in range(len(cell.channel)):
        kind = cell.kind[i]
        if not work.places.needs_colour[plane, cell.channel[i]]:
            continue
        if cell.period[kind, 0] != last_period:
            last_period = cell.period[kind, 0]
            _locate_along_x(row, size, cell, kind)
        if cell.y_group[i] != last_height:
            last_height = cell.y_group[i]
            _locate_along_y(row, size, cell, i)
        if cell.kind_y_group[i] != last_row:
            last_row = cell.kind_y_group[i]
            _fill_weights_along_y(work, nodes, plane, kind)
            _add_up_harmonics(row, nodes, image.sites, plane, kind, v)
        _add_subpixel(work, pixels, stride, size, image, plane, i)
