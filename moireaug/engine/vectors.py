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

INDEX, NUMBER = types.int32, types.float32
FOUR = 4  # sums of `add_taps_of_four`


def _row(array) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _floats(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.float32 for a in arrays)


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


def _down_weights(cells: int):
    """Make an intrinsic that stores the weights of `cells` cells."""

    @intrinsic
    def down_weights(typing, out, start, table, to_next, place, between, share):
        """Fill out[start:] with `cells` numbers of a table, see `intrinsics._weights`. Numbers
        float32, indices int32."""
        if not _floats(out, table):
            return None
        kinds = out, INDEX, table, INDEX, INDEX, NUMBER, NUMBER
        return types.none(*kinds), partial(emit_down_weights, cells)

    return down_weights


def _weighted_cells(cells: int, rows: int):
    """Make an intrinsic that weighs the `rows` rows in the middle of `cells` x `cells` cells of a
    panel; those above and below weigh nothing."""

    @intrinsic
    def weighted_cells(
        typing, panel, at, stride, table, to_next, place, between, share, down, start
    ):
        """Return the sum of panel[at + j * stride + i] * across[i] * down[start + j] over
        i, j < cells, float32.

        across is `cells` numbers of the table, see `intrinsics._weights`. Numbers float32, indices
        int32.
        """
        if not _floats(panel, table, down):
            return None
        kinds = panel, INDEX, INDEX, table, INDEX, INDEX, NUMBER, NUMBER, down, INDEX
        return NUMBER(*kinds), partial(emit_weighted_cells, cells, rows)

    return weighted_cells


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


four_weights, eight_weights = _down_weights(4), _down_weights(8)
four_by_four, eight_by_six = _weighted_cells(4, 4), _weighted_cells(8, 6)
eight_by_eight = _weighted_cells(8, 8)
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
