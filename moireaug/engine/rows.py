"""Where the pixels of each plane's rows lie, and what a row of them is computed in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moireaug.engine import harmonics, lookup
from moireaug.engine.compiling import fill, inner, part
from moireaug.engine.nodes import bracket
from moireaug.engine.shares import sizes

ZERO, ONE = np.float32(0), np.float32(1)

# what the rows of a Row's arrays hold
X, Y, U, V = range(4)
NEAREST_X, NEAREST_Y, FIRST_X, FIRST_Y, BASE, PLACE, BITS = range(7)
PAST_X, PAST_Y, BETWEEN, CONTENT, THROUGH, LIGHT, NUMBERS = range(7)
EVEN, ODD, HERE, BESIDE, COS_X, SIN_X = range(6)
COS_Y, SIN_Y = range(2)


class Places(NamedTuple):
    """Where the pixels of each plane's rows lie.

    Args:
        u: (planes, w) float64, photo columns about the centre.
        column: (kinds, 2, planes, w) int32, where the weights along x and along y begin of the node
            before each pixel. share: (planes, w) float32, how far the pixel is towards the next.
        first: (planes,), the first plane with pixels at the same places.
        asked: (planes, 3), for first planes: the colours of light that any filter at those places
            passes.
    """

    u: np.ndarray
    column: np.ndarray
    share: np.ndarray
    first: np.ndarray
    asked: np.ndarray


@inner
def _columns(u, column, share, cols, first, step, node_step, count):
    """Fill where each pixel of a row lies on the photo, and between which columns of nodes."""
    for i in range(len(u)):
        u[i] = cols[first + i * step]
        node, t = bracket(u[i], cols[0], node_step, count, 1)
        column[i], share[i] = node, t


@inner
def _begin(out, column, size, offset):
    """Fill where the weights of each pixel's node begin."""
    for i in range(len(out)):
        out[i] = column[i] * size + offset


@inner
def _sites(first, asked, sites, filters):
    """Fill first and asked of `Places`."""
    for plane in range(len(first)):
        first[plane] = plane
        if plane > 0:
            before = first[plane - 1]
            if sites.row[plane] == sites.row[before] and sites.col[plane] == sites.col[before]:
                first[plane] = before
        for colour in range(3):
            asked[plane, colour] = False
            if filters[sites.channel[plane], colour] != 0:
                asked[first[plane], colour] = True


@part
def places_of(w, planes, sites, nodes, filters):
    """Return the Places of a reading w wide."""
    kinds = len(nodes.tables)
    u, share = np.empty((planes, w), np.float64), np.empty((planes, w), np.float32)
    node, column = np.empty(w, np.int32), np.empty((kinds, 2, planes, w), np.int32)
    for plane in range(planes):
        _columns(
            u[plane],
            node,
            share[plane],
            sites.cols,
            sites.col[plane],
            sites.step,
            nodes.step_uw,
            nodes.columns,
        )
        for kind in range(kinds):
            of_x, of_both = sizes(nodes.phases[kind], nodes.cells[kind])
            _begin(column[kind, 0, plane], node, of_both, 0)
            _begin(column[kind, 1, plane], node, of_both, of_x)
    first, asked = np.empty(planes, np.int64), np.empty((planes, 3), np.bool_)
    _sites(first, asked, sites, filters)
    return Places(u, column, share, first, asked)


class Row(NamedTuple):
    """What a row of pixels is computed in.

    Args:
        weights: (kinds, ...) float32, those of cells at this row's nodes.
        at: (4, w) float64, where each pixel looks, X and Y in panel pixels, and where it lies on
            the photo, U and V about the centre.
        whole: (7, w) int32, the NEAREST cell, the FIRST of the cells that are looked at, its BASE
            on the flattened panel, and the PLACE of its weights, see `lookup`; the BITS of random
            numbers.
        line: (7, w) float32, how far PAST its nearest cell each pixel looks, in cells, and BETWEEN
            two phases; a subpixel's CONTENT and the light THROUGH its mask; all LIGHT, and random
            NUMBERS.
        glow: (3, w) float32, the light of each colour. of_rows: (w * WIDE,) float32, the weights of
            rows of cells.
        wave: (6, K + 1, w), EVEN to SIN_X, and of_y: (2, L + 1, w), COS_Y and SIN_Y, float32; see
            `harmonics`.
        orders: (kinds,) int64, how many k each kind has, 0 included.
        cos, sin: (n, K + 1) float32, from `_shifts`. weight: (4,) float32, of four rows of nodes.
    """

    weights: np.ndarray
    at: np.ndarray
    whole: np.ndarray
    line: np.ndarray
    glow: np.ndarray
    of_rows: np.ndarray
    wave: np.ndarray
    of_y: np.ndarray
    orders: np.ndarray
    cos: np.ndarray
    sin: np.ndarray
    weight: np.ndarray


@inner
def _shifts(cos, sin, cell):
    """Fill cos and sin (n, K + 1) with those of 2 pi k x at each subpixel's centre x."""
    for i in range(len(cos)):
        for k in range(cos.shape[1]):
            angle = 2 * math.pi * k * cell.centre[i, 0] / cell.period[cell.kind[i], 0]
            cos[i, k], sin[i, k] = math.cos(angle), math.sin(angle)


@part
def row_of(w, cell, nodes):
    """Return the Row of a reading w wide."""
    kinds, _, n = nodes.tables.shape
    orders, n_k, n_l = np.ones(kinds, np.int64), 1, 1
    for i in range(len(nodes.terms)):
        kind, k = nodes.terms[i, harmonics.KIND], nodes.terms[i, harmonics.K] + 1
        orders[kind], n_k = max(orders[kind], k), max(n_k, k)
        n_l = max(n_l, nodes.terms[i, harmonics.L] + 1)
    wave, of_y = np.empty((6, n_k, w), np.float32), np.empty((2, n_l, w), np.float32)
    # those of k = 0 and l = 0
    fill(wave[COS_X, 0], ONE)
    fill(wave[SIN_X, 0], ZERO)
    fill(of_y[COS_Y, 0], ONE)
    fill(of_y[SIN_Y, 0], ZERO)
    subpixels = len(cell.channel)
    cos, sin = np.empty((subpixels, n_k), np.float32), np.empty((subpixels, n_k), np.float32)
    _shifts(cos, sin, cell)
    return Row(
        np.empty((kinds, n), np.float32),
        np.empty((4, w), np.float64),
        np.empty((7, w), np.int32),
        np.empty((7, w), np.float32),
        np.empty((3, w), np.float32),
        np.empty(w * lookup.WIDE, np.float32),
        wave,
        of_y,
        orders,
        cos,
        sin,
        np.empty(4, np.float32),
    )
