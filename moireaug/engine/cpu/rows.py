"""Where the pixels of each plane's rows lie, and what a row of them is computed in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.engine.cpu import harmonics, lookup
from moireaug.engine.cpu.coarse_grid import bracket
from moireaug.engine.cpu.compiling import fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.tap_weights import weights_per_node

ZERO, ONE = np.float32(0), np.float32(1)

# what the rows of a Row's arrays hold
X, Y, U, V = range(4)
NEAREST_CELL_X, NEAREST_CELL_Y, FIRST_CELL_X, FIRST_CELL_Y, BASE_INDEX = range(5)
WEIGHT_INDEX, NOISE_BITS = range(5, 7)
CELL_OFFSET_X, CELL_OFFSET_Y, PHASE_SHARE, CONTENT, MODULATION, LIGHT, NOISE = range(7)
EVEN, ODD, IN_PHASE, QUADRATURE, COS_X, SIN_X = range(6)
COS_Y, SIN_Y = range(2)


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


class Row(NamedTuple):
    """What a row of pixels is computed in.

    Args:
        weights: (kinds, ...) float32, the tap weights at this row's nodes.
        position: (4, w) float64, where each pixel looks, X and Y in panel pixels, and where it lies
            on the photo, U and V about the centre.
        ints: (7, w) int32, the cell nearest to where each pixel looks, the FIRST_CELL of its taps,
            the BASE_INDEX of that on the flattened panel, and the WEIGHT_INDEX of
            `records.TapWeights`; the NOISE_BITS that random numbers are made from.
        floats: (7, w) float32, each pixel's CELL_OFFSET from the nearest cell, in cells, and its
            PHASE_SHARE of `records.TapWeights`; a subpixel's CONTENT, and the MODULATION
            of it; the LIGHT of all colours, and the sensor's NOISE.
        irradiance: (3, w) float32, the panel's light of each colour, or the gradient in it.
        weights_x, weights_y: (w * WIDE_TAPS,) float32, the tap weights along x, of the gradient
            alone, and along y.
        wave: (6, K + 1, w), EVEN to SIN_X, and wave_y: (2, L + 1, w), COS_Y and SIN_Y, float32; see
            `harmonics`.
        orders: (kinds,) int64, how many k each kind has, 0 included.
        cos, sin: (n, K + 1) float32, from `_shifts`.
    """

    weights: np.ndarray
    position: np.ndarray
    ints: np.ndarray
    floats: np.ndarray
    irradiance: np.ndarray
    weights_x: np.ndarray
    weights_y: np.ndarray
    wave: np.ndarray
    wave_y: np.ndarray
    orders: np.ndarray
    cos: np.ndarray
    sin: np.ndarray


@jit_in_place
def _shifts(cos, sin, cell):
    """Fill cos and sin (n, K + 1) with those of 2 pi k x at each subpixel's centre x."""
    for i in range(len(cos)):
        for k in range(cos.shape[1]):
            angle = 2 * math.pi * k * cell.centre[i, 0] / cell.period[cell.subpixel_kind[i], 0]
            cos[i, k], sin[i, k] = math.cos(angle), math.sin(angle)


@jit_inlined
def row_of(w, cell, grid):
    """Return the Row of a reading w wide."""
    kinds, _, n = grid.tables.shape
    orders, n_k, n_l = np.ones(kinds, np.int64), 1, 1
    for i in range(len(grid.terms)):
        kind, k = grid.terms[i, harmonics.KIND], grid.terms[i, harmonics.K] + 1
        orders[kind], n_k = max(orders[kind], k), max(n_k, k)
        n_l = max(n_l, grid.terms[i, harmonics.L] + 1)
    wave, wave_y = np.empty((6, n_k, w), np.float32), np.empty((2, n_l, w), np.float32)
    # those of k = 0 and l = 0
    fill(wave[COS_X, 0], ONE)
    fill(wave[SIN_X, 0], ZERO)
    fill(wave_y[COS_Y, 0], ONE)
    fill(wave_y[SIN_Y, 0], ZERO)
    subpixels = len(cell.channel)
    cos, sin = np.empty((subpixels, n_k), np.float32), np.empty((subpixels, n_k), np.float32)
    _shifts(cos, sin, cell)
    return Row(
        np.empty((kinds, n), np.float32),
        np.empty((4, w), np.float64),
        np.empty((7, w), np.int32),
        np.empty((7, w), np.float32),
        np.empty((3, w), np.float32),
        np.empty(w * lookup.WIDE_TAPS, np.float32),
        np.empty(w * lookup.WIDE_TAPS, np.float32),
        wave,
        wave_y,
        orders,
        cos,
        sin,
    )
