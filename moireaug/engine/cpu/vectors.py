"""Loads and stores declared not to overlap, so that LLVM vectorises a loop; and vectorised sums of
rows."""

from __future__ import annotations

from functools import partial

from numba import types
from numba.extending import intrinsic

from moireaug.engine.cpu.compiling import inner
from moireaug.engine.cpu.intrinsics import (
    emit_content,
    emit_content_back,
    emit_peek,
    emit_poke,
    emit_tap_weights,
)
from moireaug.engine.cpu.records import TapWeights

SUMS_AT_ONCE = 4  # of `add_four_sums`
LANES = 16  # float32 that loops work on at once; rows are padded to a multiple
VECTOR_LANES = 16  # float32 in a vector of tap weights


def _row(array) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _floats(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.float32 for a in arrays)


def _indices(*arrays) -> bool:
    return all(_row(a) and a.dtype == types.int32 for a in arrays)


def _is_tap_weights(record) -> bool:
    if not isinstance(record, types.NamedTuple) or record.instance_class is not TapWeights:
        return False
    table, _, index, phase_share, node_share = record.types
    return _floats(table, phase_share, node_share) and _indices(index)


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


def _vector_of_weights(taps: int, pixels: int):
    """Make an intrinsic that stores `taps` tap weights for each of `pixels` pixels."""

    @intrinsic
    def store_weights(typing, out, weights, first):
        """Do the same as `fill_four_weights`, for the `pixels` pixels from `first` on."""
        if not _floats(out) or not _is_tap_weights(weights):
            return None
        return types.none(out, weights, first), partial(emit_tap_weights, taps, pixels)

    return store_weights


def _weights_of(taps: int):
    """Make the function that fills a row with `taps` tap weights per pixel, a vector at a time."""
    at_once = VECTOR_LANES // taps
    store_many, store_one = _vector_of_weights(taps, at_once), _vector_of_weights(taps, 1)

    @inner
    def fill_weights(out, weights):
        """Fill out (n * taps,) with the tap weights of n pixels.

        weights: see `records.TapWeights`.
        """
        n = len(weights.weight_index)
        whole = n - n % at_once
        for i in range(0, whole, at_once):
            store_many(out, weights, i)
        for i in range(whole, n):
            store_one(out, weights, i)

    return fill_weights


def _vector_of_content(taps: int, rows: int, pixels: int):
    """Make an intrinsic that weighs `taps` x `taps` cells of a panel for each of `pixels` pixels.
    Only the `rows` rows in the middle have weight."""

    @intrinsic
    def store_content(typing, out, panel, base, stride, weights, down, first):
        """Do the same as `four_by_four`, for the `pixels` pixels from `first` on."""
        if not _floats(out, panel, down) or not _indices(base) or not _is_tap_weights(weights):
            return None
        kinds = out, panel, base, stride, weights, down, first
        return types.none(*kinds), partial(emit_content, taps, rows, pixels)

    return store_content


def _content_of(taps: int, rows: int):
    """Make the function that weighs the cells that a row of pixels sees, a vector at a time."""
    at_once = VECTOR_LANES // taps
    store_many = _vector_of_content(taps, rows, at_once)
    store_one = _vector_of_content(taps, rows, 1)

    @inner
    def content(out, panel, base, stride, weights, down):
        """Fill out (n,), for each pixel, with the sum of
        panel[base + j * stride + i] * across[i] * down[taps * pixel + j] over i, j < taps.

        across: the pixel's tap weights along x, from `weights`, a `records.TapWeights`.
        """
        whole = len(out) - len(out) % at_once
        for i in range(0, whole, at_once):
            store_many(out, panel, base, stride, weights, down, i)
        for i in range(whole, len(out)):
            store_one(out, panel, base, stride, weights, down, i)

    return content


def _content_back_of(taps: int, rows: int):
    """Make the transpose of what `_content_of` makes, a pixel at a time: neighbours add to the same
    cells."""

    @intrinsic
    def add_content(typing, panel, base, stride, weights_x, weights_y, grad, pixel):
        """Do the same as `content_back`, for one pixel."""
        if not _floats(panel, weights_x, weights_y, grad) or not _indices(base):
            return None
        kinds = panel, base, stride, weights_x, weights_y, grad, pixel
        return types.none(*kinds), partial(emit_content_back, taps, rows)

    @inner
    def content_back(panel, grad, base, stride, weights_x, weights_y):
        """Add grad[pixel] * across[i] * down[j] to panel[base + j * stride + i] for each pixel and
        i, j < taps; across, down: the pixel's tap weights."""
        for i in range(len(grad)):
            add_content(panel, base, stride, weights_x, weights_y, grad, i)

    return content_back


fill_four_weights, fill_eight_weights = _weights_of(4), _weights_of(8)
four_by_four, four_by_four_back = _content_of(4, 4), _content_back_of(4, 4)
eight_by_six, eight_by_six_back = _content_of(8, 6), _content_back_of(8, 6)
eight_by_eight, eight_by_eight_back = _content_of(8, 8), _content_back_of(8, 8)


@inner
def add_sum(out, coefficients, rows, offsets):
    """Add the sum over l of coefficients[l] * rows[offsets[l] + i] to out[i] (n,).

    coefficients, offsets: (taps,) float32 and int64. rows: flat float32.
    """
    for l in range(len(offsets)):
        add(out, rows[offsets[l] : offsets[l] + len(out)], coefficients[l])


@inner
def add_four_sums(out, coefficients, rows, offsets):
    """Add four sums of the same rows to out (4 * n,): to pixel i of sum j the sum over l of
    coefficients[j, l] * rows[offsets[l] + i].

    coefficients: (4 * t,), of which the first taps of each t are used. The rest as in `add_sum`.
    """
    n, each = len(out) // SUMS_AT_ONCE, len(coefficients) // SUMS_AT_ONCE
    for j in range(SUMS_AT_ONCE):
        add_sum(out[j * n : (j + 1) * n], coefficients[j * each : (j + 1) * each], rows, offsets)


@inner
def padded_width(n):
    """Return the length of a row of n values, padded to whole LANES."""
    return (n + LANES - 1) // LANES * LANES


@inner
def add(out, row, factor):
    """Add factor * row to out, (n,) each."""
    for i in range(len(out)):
        poke(out, i, out[i] + factor * peek(row, i))


@inner
def gather(out, row, index, weight):
    """Fill out (n,) with sums over taps of weight[t] * row[index[t]]."""
    for t in range(len(index)):
        _add_gathered(out, row, index[t], weight[t], t == 0)


@inner
def _add_gathered(out, row, index, weight, first):
    if first:
        for i in range(len(out)):
            poke(out, i, peek(weight, i) * peek(row, peek(index, i)))
    else:
        for i in range(len(out)):
            poke(out, i, out[i] + peek(weight, i) * peek(row, peek(index, i)))
