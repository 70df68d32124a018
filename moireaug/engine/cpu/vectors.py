"""Rows of tap weights, of what pixels see through them, and sums of rows."""

from __future__ import annotations

from moireaug.engine.cpu.compiling import jit_in_place
from moireaug.engine.cpu.intrinsics import (
    content_adding,
    content_weighing,
    load,
    store,
    tap_weights_storing,
)

SUMS_AT_ONCE = 4  # of `add_four_sums`
LANES = 16  # float32 that loops work on at once; rows are padded to a multiple


def _weights_of(taps: int):
    """Make the function that fills a row with `taps` tap weights per pixel."""
    store_weights = tap_weights_storing(taps)

    @jit_in_place
    def fill_weights(out, weights):
        """Fill out (n * taps,) with the tap weights of n pixels.

        weights: see `records.TapWeights`.
        """
        for i in range(len(weights.weight_index)):
            store_weights(out, weights, i)

    return fill_weights


def _content_of(taps: int):
    """Make the function that weighs the cells that a row of pixels sees."""
    content_at = content_weighing(taps)

    @jit_in_place
    def content(out, panel, base, stride, weights, down):
        """Fill out (n,), for each pixel, with the sum of
        panel[base + j * stride + i] * across[i] * down[taps * pixel + j] over i, j < taps.

        across: the pixel's tap weights along x, from `weights`, a `records.TapWeights`.
        """
        for i in range(len(out)):
            out[i] = content_at(panel, base, stride, weights, down, i)

    return content


def _content_back_of(taps: int):
    """Make the transpose of what `_content_of` makes."""
    add_content = content_adding(taps)

    @jit_in_place
    def content_back(panel, grad, base, stride, weights_x, weights_y):
        """Add grad[pixel] * across[i] * down[j] to panel[base + j * stride + i] for each pixel and
        i, j < taps; across, down: the pixel's tap weights."""
        for i in range(len(grad)):
            add_content(panel, base, stride, weights_x, weights_y, grad, i)

    return content_back


fill_four_weights, fill_eight_weights = _weights_of(4), _weights_of(8)
four_by_four, four_by_four_back = _content_of(4), _content_back_of(4)
eight_by_eight, eight_by_eight_back = _content_of(8), _content_back_of(8)


@jit_in_place
def add_sum(out, coefficients, rows, offsets):
    """Add the sum over l of coefficients[l] * rows[offsets[l] + i] to out[i] (n,).

    coefficients, offsets: (taps,) float32 and int64. rows: flat float32.
    """
    for l in range(len(offsets)):
        add(out, rows[offsets[l] : offsets[l] + len(out)], coefficients[l])


@jit_in_place
def add_four_sums(out, coefficients, rows, offsets):
    """Add four sums of the same rows to out (4 * n,): to pixel i of sum j the sum over l of
    coefficients[j, l] * rows[offsets[l] + i].

    coefficients: (4 * t,), of which the first taps of each t are used. The rest as in `add_sum`.
    """
    n, each = len(out) // SUMS_AT_ONCE, len(coefficients) // SUMS_AT_ONCE
    for j in range(SUMS_AT_ONCE):
        add_sum(out[j * n : (j + 1) * n], coefficients[j * each : (j + 1) * each], rows, offsets)


@jit_in_place
def padded_width(n):
    """Return the length of a row of n values, padded to whole LANES."""
    return (n + LANES - 1) // LANES * LANES


@jit_in_place
def add(out, row, factor):
    """Add factor * row to out, (n,) each."""
    for i in range(len(out)):
        store(out, i, out[i] + factor * load(row, i))


@jit_in_place
def gather(out, row, index, weight):
    """Fill out (n,) with sums over taps of weight[t] * row[index[t]]."""
    for t in range(len(index)):
        _add_gathered(out, row, index[t], weight[t], t == 0)


@jit_in_place
def _add_gathered(out, row, index, weight, first):
    if first:
        for i in range(len(out)):
            store(out, i, load(weight, i) * load(row, load(index, i)))
    else:
        for i in range(len(out)):
            store(out, i, out[i] + load(weight, i) * load(row, load(index, i)))
