"""Where the pixels of each plane's rows lie, and what a row of them is computed in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu import harmonics, lookup
from moireaug.engine.cpu.coarse_grid import bracket
from moireaug.engine.cpu.compiling import fill, jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.tap_weights import weights_per_node

ZERO, ONE = np.float32(0), np.float32(1)


class RowLayout(NamedTuple):
    """Where the pixels of each plane's rows lie.

    Args:
        u: (planes, w) float64, photo columns about the centre.
        weight_start: (kinds, 2, planes, w) int32, index in a table of tap weights of those along x
            and of those along y, at the node before each pixel. node_share: (planes, w) float32,
            how far the pixel is towards the next node.
        first: (planes,) int64, the first plane with pixels at the same layout.
        needs_colour: (planes, 3) bool, of first planes: whether any filter at those places passes
            each colour.
    """

    u: np.ndarray
    weight_start: np.ndarray
    node_share: np.ndarray
    first: np.ndarray
    needs_colour: np.ndarray


@jit_in_place
def _fill_columns(u, column, node_share, sites, plane, grid):
    """Fill where each pixel of a plane's row lies on the photo, and between which columns of
    nodes."""
    for i in range(len(u)):
        u[i] = sites.cols[sites.col[plane] + i * sites.step]
        node, t = bracket(u[i], sites.cols[0], grid.step_uw, grid.columns, 1)
        column[i], node_share[i] = node, t


@jit_in_place
def _fill_starts(out, column, size, offset):
    """Fill out (w,) int32 with where the weights of each pixel's node start, along one axis."""
    for i in range(len(out)):
        out[i] = column[i] * size + offset


@jit_in_place
def _fill_first(first, needs_colour, sites, filters):
    """Fill first and needs_colour of `RowLayout`."""
    for plane in range(len(first)):
        first[plane] = plane
        if plane > 0:
            before = first[plane - 1]
            if sites.row[plane] == sites.row[before] and sites.col[plane] == sites.col[before]:
                first[plane] = before
        for colour in range(3):
            needs_colour[plane, colour] = False
            if filters[sites.channel[plane], colour] != 0:
                needs_colour[first[plane], colour] = True


@jit_inlined
def row_layout_of(w, planes, sites, grid, filters):
    """Return the RowLayout of a reading w wide."""
    kinds = len(grid.tables)
    u, node_share = np.empty((planes, w), np.float64), np.empty((planes, w), np.float32)
    column, start = np.empty(w, np.int32), np.empty((kinds, 2, planes, w), np.int32)
    for plane in range(planes):
        _fill_columns(u[plane], column, node_share[plane], sites, plane, grid)
        for kind in range(kinds):
            along_x, along_both = weights_per_node(grid.phases[kind], grid.taps[kind])
            _fill_starts(start[kind, 0, plane], column, along_both, 0)
            _fill_starts(start[kind, 1, plane], column, along_both, along_x)
    first, needs_colour = np.empty(planes, np.int64), np.empty((planes, 3), np.bool_)
    _fill_first(first, needs_colour, sites, filters)
    return RowLayout(u, start, node_share, first, needs_colour)


class Position(NamedTuple):
    """Where a row's pixels look, x and y in panel pixels, and where they lie on the photo, u and v
    about the centre: (w,) float64 each."""

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    v: np.ndarray


class AxisCells(NamedTuple):
    """The cells that a row's pixels see along one axis of the panel, and the waves there.

    Args:
        nearest: (w,) int32, the cell nearest to where each pixel looks. offset: (w,) float32, how
            far that is from there, in cells.
        first: (w,) int32, the cell of the first tap.
        cos, sin: (orders, w) float32, see `harmonics.fill_waves`.
    """

    nearest: np.ndarray
    offset: np.ndarray
    first: np.ndarray
    cos: np.ndarray
    sin: np.ndarray


class Row(NamedTuple):
    """What a row of pixels is computed in.

    Args:
        position: where they look and lie. along_x, along_y: the cells that they see.
        weights: (kinds, ...) float32, the tap weights at this row's nodes. weight_index,
            phase_share: (w,) int32 and float32, see `records.TapWeights`.
        weights_x, weights_y: (w * WIDE_TAPS,) float32, the tap weights along x, of the gradient
            alone, and along y. base: (w,) int32, the first cell of both on the flattened panel.
        even, odd, in_phase, quadrature: (K + 1, w) float32, see `harmonics`. orders: (kinds,)
            int64, how many k each kind has, 0 included. centre_cos, centre_sin: (n, K + 1) float32,
            from `_fill_centre_waves`.
        content, modulation: (w,) float32, the content of a subpixel, and the modulation of it.
        irradiance: (3, w) float32, the panel's light of each colour, or the gradient in it.
        light, noise: (w,) float32, the light of all colours, and the sensor's noise. noise_bits:
            (w,) int32, that random numbers are made from.
    """

    position: Position
    along_x: AxisCells
    along_y: AxisCells
    weights: np.ndarray
    weight_index: np.ndarray
    phase_share: np.ndarray
    weights_x: np.ndarray
    weights_y: np.ndarray
    base: np.ndarray
    even: np.ndarray
    odd: np.ndarray
    in_phase: np.ndarray
    quadrature: np.ndarray
    orders: np.ndarray
    centre_cos: np.ndarray
    centre_sin: np.ndarray
    content: np.ndarray
    modulation: np.ndarray
    irradiance: np.ndarray
    light: np.ndarray
    noise: np.ndarray
    noise_bits: np.ndarray


@jit_in_place
def _fill_centre_waves(cos, sin, cell):
    """Fill cos and sin (n, K + 1) with those of 2 pi k x at each subpixel's centre x."""
    for i in range(len(cos)):
        for k in range(cos.shape[1]):
            angle = 2 * math.pi * k * cell.centre[i, 0] / cell.period[cell.subpixel_kind[i], 0]
            cos[i, k], sin[i, k] = math.cos(angle), math.sin(angle)


@jit
def _axis_cells(w, orders):
    """Return the AxisCells of w pixels, with the waves of order 0."""
    cos, sin = np.empty((orders, w), np.float32), np.empty((orders, w), np.float32)
    fill(cos[0], ONE)
    fill(sin[0], ZERO)
    nearest, first = np.empty(w, np.int32), np.empty(w, np.int32)
    return AxisCells(nearest, np.empty(w, np.float32), first, cos, sin)


@jit_inlined
def row_of(w, cell, grid):
    """Return the Row of a reading w wide."""
    kinds, _, n = grid.tables.shape
    orders, n_k, n_l = np.ones(kinds, np.int64), 1, 1
    for i in range(len(grid.terms)):
        kind, k = grid.terms[i, harmonics.KIND], grid.terms[i, harmonics.K] + 1
        orders[kind], n_k = max(orders[kind], k), max(n_k, k)
        n_l = max(n_l, grid.terms[i, harmonics.L] + 1)
    subpixels = len(cell.channel)
    cos, sin = np.empty((subpixels, n_k), np.float32), np.empty((subpixels, n_k), np.float32)
    _fill_centre_waves(cos, sin, cell)
    return Row(
        position=Position(np.empty(w), np.empty(w), np.empty(w), np.empty(w)),
        along_x=_axis_cells(w, n_k),
        along_y=_axis_cells(w, n_l),
        weights=np.empty((kinds, n), np.float32),
        weight_index=np.empty(w, np.int32),
        phase_share=np.empty(w, np.float32),
        weights_x=np.empty(w * lookup.WIDE_TAPS, np.float32),
        weights_y=np.empty(w * lookup.WIDE_TAPS, np.float32),
        base=np.empty(w, np.int32),
        even=np.empty((n_k, w), np.float32),
        odd=np.empty((n_k, w), np.float32),
        in_phase=np.empty((n_k, w), np.float32),
        quadrature=np.empty((n_k, w), np.float32),
        orders=orders,
        centre_cos=cos,
        centre_sin=sin,
        content=np.empty(w, np.float32),
        modulation=np.empty(w, np.float32),
        irradiance=np.empty((3, w), np.float32),
        light=np.empty(w, np.float32),
        noise=np.empty(w, np.float32),
        noise_bits=np.empty(w, np.int32),
    )
