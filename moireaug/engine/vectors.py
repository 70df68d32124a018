"""Loads and stores declared not to overlap, so that LLVM vectorises a loop; and vectorised sums of
rows."""

from __future__ import annotations

from functools import partial

from numba import types
from numba.extending import intrinsic

from moireaug.engine.compiling import inner
from moireaug.engine.development_records import LANES
from moireaug.engine.intrinsics import (
    emit_down_weights,
    emit_peek,
    emit_poke,
    emit_taps,
    emit_weighted_cells,
)

FOUR = 4  # sums of `add_taps_of_four`


def _row(array) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _floats(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.float32 for a in arrays)


def _indices(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.int32 for a in arrays)


@intrinsic
def peek(typing, array, index):
    """Return array[index] of a contiguous one-dimensional array that no `poke` of the same function
    writes to.

    The index must be in range, and not negative.
    """
    if not _row(array):
        return None
    return array.dtype(array, index), emit_peek


@intrinsic
def poke(typing, array, index, value):
    """Set array[index] = value, of an array that no `peek` of the same function reads."""
    if not _row(array):
        return None
    return types.none(array, index, value), emit_poke


def _down_weights(cells: int, pixels: int):
    """Make an intrinsic that stores the weights of so many cells for as many pixels."""

    @intrinsic
    def down_weights(typing, out, table, to_next, place, between, share, first):
        """Do the same as `four_weights`, for the `pixels` pixels from `first` on."""
        if not _floats(out, table, between, share) or not _indices(place):
            return None
        kinds = out, table, to_next, place, between, share, first
        return types.none(*kinds), partial(emit_down_weights, cells, pixels)

    return down_weights


def _weights_of(cells: int):
    """Make what fills a row with the weights of so many cells: 16 of them at once."""
    at_once = 16 // cells
    many, one = _down_weights(cells, at_once), _down_weights(cells, 1)

    @inner
    def weights(out, table, to_next, place, between, share):
        """Fill out (n * cells,) with the numbers of a table for each pixel, see
        `intrinsics._weights`; the other arrays are (n,)."""
        whole = len(share) - len(share) % at_once
        for i in range(0, whole, at_once):
            many(out, table, to_next, place, between, share, i)
        for i in range(whole, len(share)):
            one(out, table, to_next, place, between, share, i)

    return weights


def _weighted_cells(cells: int, rows: int, pixels: int):
    """Make an intrinsic that weighs the `rows` rows in the middle of `cells` x `cells` cells of a
    panel, for as many pixels; those above and below weigh nothing."""

    @intrinsic
    def weighted_cells(
        typing, out, panel, base, stride, table, to_next, place, between, share, down, first
    ):
        """Do the same as `four_by_four`, for the `pixels` pixels from `first` on."""
        floats = _floats(out, panel, table, between, share, down)
        if not floats or not _indices(base, place):
            return None
        kinds = out, panel, base, stride, table, to_next, place, between, share, down, first
        return types.none(*kinds), partial(emit_weighted_cells, cells, rows, pixels)

    return weighted_cells


def _content_of(cells: int, rows: int):
    """Make what weighs the cells that a row of pixels looks at: 16 columns of them at once."""
    at_once = 16 // cells
    many, one = _weighted_cells(cells, rows, at_once), _weighted_cells(cells, rows, 1)

    @inner
    def content(out, panel, base, stride, table, to_next, place, between, share, down):
        """Fill out (n,), for each pixel, with the sum of
        panel[base + j * stride + i] * across[i] * down[cells * pixel + j] over i, j < cells.

        across is `cells` numbers of the table, see `intrinsics._weights`.
        """
        whole = len(out) - len(out) % at_once
        for i in range(0, whole, at_once):
            many(out, panel, base, stride, table, to_next, place, between, share, down, i)
        for i in range(whole, len(out)):
            one(out, panel, base, stride, table, to_next, place, between, share, down, i)

    return content


def _taps(lanes: int, sums: int):
    """Make an intrinsic that sums rows for `lanes` pixels at once, with as many sets of
    coefficients."""

    @intrinsic
    def taps(typing, out, start, apart, coefficients, first, each, count, rows, offsets, base):
        """Do the same as `add_taps`, for the `lanes` pixels from `start` on; the sums lie `apart`
        from one another, and their coefficients `each` from one another."""
        if not _floats(out, coefficients, rows):
            return None
        kinds = out, start, apart, coefficients, first, each, count, rows, offsets, base
        return types.none(*kinds), partial(emit_taps, lanes, sums)

    return taps


four_weights, eight_weights = _weights_of(4), _weights_of(8)
four_by_four, eight_by_six, eight_by_eight = _content_of(4, 4), _content_of(8, 6), _content_of(8, 8)
# as many sums as there are registers for
_few, _many = _taps(LANES, 1), _taps(4 * LANES, 1)
_few_of_four, _more_of_four = _taps(LANES, FOUR), _taps(2 * LANES, FOUR)


@inner
def add_taps(out, start, lanes, coefficients, first, count, rows, offsets, base):
    """Add the sum over l < count of coefficients[first + l] * rows[base + offsets[first + l] + i]
    to out[start + i], for i < lanes, a multiple of LANES. Offsets are int64, the other arrays
    float32."""
    wide = lanes - lanes % (4 * LANES)
    for i in range(0, wide, 4 * LANES):
        _many(out, start + i, 0, coefficients, first, 0, count, rows, offsets, base + i)
    for i in range(wide, lanes, LANES):
        _few(out, start + i, 0, coefficients, first, 0, count, rows, offsets, base + i)


@inner
def add_taps_of_four(out, lanes, coefficients, size, count, rows, offsets):
    """Add four sums of the same rows to out, which holds them one after another: to pixel i of sum
    j the sum over l < count of coefficients[j * size + l] * rows[offsets[l] + i]. Each row is
    loaded once; for one sum after another, loading takes most of the time. The rest as in
    `add_taps`."""
    wide = lanes - lanes % (2 * LANES)
    for i in range(0, wide, 2 * LANES):
        _more_of_four(out, i, lanes, coefficients, 0, size, count, rows, offsets, i)
    for i in range(wide, lanes, LANES):
        _few_of_four(out, i, lanes, coefficients, 0, size, count, rows, offsets, i)


@inner
def add(out, row, factor):
    """Add factor * row to out, (n,) each."""
    for i in range(len(out)):
        poke(out, i, out[i] + factor * peek(row, i))
