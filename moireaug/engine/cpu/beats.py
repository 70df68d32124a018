"""Beats: the panel's harmonics as the pixels of a binned reading see them, each alias a slow wave.

The amplitude of a term changes slowly over the photo: it is computed on a grid of nodes and
interpolated by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.cpu import beat_terms, harmonics
from moireaug.engine.cpu.beat_grid import grid_at, node_counts, sampled_grid, transfer_of
from moireaug.engine.cpu.beat_terms import ALIAS_U, ALIAS_V, HARMONIC
from moireaug.engine.cpu.coarse_grid import bracket, fill_cubics, node_line
from moireaug.engine.cpu.compiling import copy, fill, jit_in_place, jit_inlined
from moireaug.engine.cpu.lost_pattern import lost_pattern_variance
from moireaug.engine.cpu.records import Terms
from moireaug.engine.cpu.rows import U, V, X, Y
from moireaug.engine.cpu.vectors import load, store

ONE, ZERO = np.float32(1), np.float32(0)
# terms times pixels of a row, above which amplitudes are kept at nodes: at pixels, a photo's would
# take hundreds of megabytes
MAX_LINE_VALUES = 2**19
PER_X, PER_Y, PER_U, PER_V, IN_MIDDLE = range(5)  # columns of a wave
GREEN, BLUE = 1, 2  # planes
PHASE, COS, SIN, COLOURED_AMPLITUDE, GREEN_AMPLITUDE = range(5)  # rows of a term's workspace


@jit_in_place
def _fill_lines(lines, peak, amplitude, strong, ends, weight, strength):
    """Fill lines (rows, T * 2 * w) with the amplitudes of the `strong` terms at the pixels of each
    row of nodes, or at the nodes; and peak (rows, T) with the greatest of each, times strength
    (T,)."""
    width = lines.shape[1] // max(2 * len(strong), 1)
    for r in range(len(lines)):
        for t in range(len(strong)):
            peak[r, t] = ZERO
            for plane in range(2):
                start, values = (2 * t + plane) * width, amplitude[r, :, strong[t], plane]
                line = lines[r, start : start + width]
                if width == weight.shape[1]:
                    harmonics.interpolate_line(line, values, ends, weight)
                else:
                    copy(line, values)
                for c in range(len(values)):
                    peak[r, t] = max(peak[r, t], abs(values[c]) * strength[t])


@jit_in_place
def _fill_waves(wave, sign, terms, strong, cycles, start, camera):
    """Fill wave (T, 5) with each term's cycles per pixel of the shown panel along x and y, per
    photo pixel along u and v, and in the photo's middle; and sign (T, 3) with its sign in each
    plane, 0 where that of green does not read it.

    Args:
        cycles: (H, 2), of each harmonic along x and y. start: where the shown panel begins, in its
            pixels along both.
    """
    scale = camera.scale_u
    across, down = scale * camera.photo_width / 2 - 0.5, scale * camera.photo_height / 2 - 0.5
    for t in range(len(strong)):
        term = terms[strong[t]]
        m_u, m_v, (x, y) = term[ALIAS_U], term[ALIAS_V], cycles[term[HARMONIC]]
        wave[t, PER_X], wave[t, PER_Y] = x, y
        wave[t, PER_U], wave[t, PER_V] = -m_u * scale / 2, -m_v * scale / 2
        before = x * start[0] + y * start[1]
        wave[t, IN_MIDDLE] = before - (m_u * across + m_v * down) / 2
        is_odd = (m_u + m_v) % 2 != 0
        sign[t, 0], sign[t, BLUE] = ONE, -ONE if is_odd else ONE
        in_green = ONE if m_u % 2 == 0 else -ONE
        sign[t, GREEN] = ZERO if is_odd else in_green


@jit_inlined
def beat_terms_of(b, i, camera, filters, sites, budget):
    """Return the Terms of image i; b: see `exposure_records.Beats`. camera: of its sensor.
    budget: an `ErrorBudget`."""
    rough = sampled_grid(sites, camera, b, i)
    table, steps_per_cycle = transfer_of(rough, camera)
    most = beat_terms.max_amplitudes(rough, b.strength[i], table, steps_per_cycle, camera)
    terms = beat_terms.candidate_terms(rough, most, budget.beat_amplitude)
    used = beat_terms.number_harmonics(terms)
    own, strength = np.empty((len(used), 2), np.int64), np.empty(len(used), np.float64)
    least, cycles = np.empty(len(used), np.float64), np.empty((len(used), 2), np.float64)
    for h in range(len(used)):
        for axis in range(2):
            own[h, axis] = b.orders[used[h], axis]
            cycles[h, axis] = own[h, axis] / b.period[axis] * b.ratio[i]
        strength[h] = b.strength[i, used[h]] * max(camera.gain, 1.0)
        least[h] = budget.beat_amplitude / 8 / strength[h]
    n_u, n_v = node_counts(rough, most, sites, camera, budget)
    us, step_u = node_line(sites.cols, n_u)
    vs, step_v = node_line(sites.rows, n_v)
    grid = grid_at(us, vs, camera, b, i, own)
    amplitude = beat_terms.amplitudes(grid, terms, least, table, steps_per_cycle, camera, b.bayer)
    strong = beat_terms.strong_terms(amplitude, terms, strength, budget.beat_amplitude)
    w = len(sites.cols)
    ends, weight = np.empty(n_u - 2, np.int64), np.empty((4, w), np.float32)
    fill_cubics(ends, weight, sites.cols, us[0], step_u)
    width = w if len(strong) * w <= MAX_LINE_VALUES else n_u
    lines = np.empty((n_v, len(strong) * 2 * width), np.float32)
    peak = np.empty((n_v, len(strong)), np.float32)
    harmonic, shown = np.empty(len(strong), np.int64), np.empty(len(strong), np.float32)
    for t in range(len(strong)):
        harmonic[t] = used[terms[strong[t], HARMONIC]]
        shown[t] = strength[terms[strong[t], HARMONIC]]
    _fill_lines(lines, peak, amplitude, strong, ends, weight, shown)
    wave, sign = np.empty((len(strong), 5), np.float64), np.empty((len(strong), 3), np.float32)
    start = b.start[i, 0] / b.ratio[i], b.start[i, 1] / b.ratio[i]
    _fill_waves(wave, sign, terms, strong, cycles, start, camera)
    lost = np.zeros(3, np.float32)
    if b.saturates:
        lost_pattern_variance(lost, b, i, filters, camera, table, steps_per_cycle)
    return Terms(
        harmonic, wave, sign, lines, peak, budget.beat_amplitude, step_v, ends, weight, lost
    )


@jit_in_place
def _phase(out, at, wave):
    x, y, u, v = at[X], at[Y], at[U], at[V]
    per_x, per_y, per_u, per_v = wave[PER_X], wave[PER_Y], wave[PER_U], wave[PER_V]
    first = wave[IN_MIDDLE]
    for i in range(len(out)):
        alias = per_u * load(u, i) + per_v * load(v, i) + first
        cycles = per_x * load(x, i) + per_y * load(y, i) + alias
        store(out, i, np.float32(cycles - math.floor(cycles + 0.5)))


@jit_in_place
def _blend(out, lines, start, weight):
    """Fill out (w,) with a line's amplitudes on a row, from those `start` on of four rows of
    nodes."""
    wa, wb, wc, wd = weight
    end = start + len(out)
    first, second, third, fourth = (
        lines[0, start:end], lines[1, start:end], lines[2, start:end], lines[3, start:end],
    )  # fmt: skip
    for i in range(len(out)):
        low = wa * load(first, i) + wb * load(second, i)
        store(out, i, low + (wc * load(third, i) + wd * load(fourth, i)))


@jit_in_place
def _fill_amplitude(out, nodes, terms, line, lines, weight):
    """Fill out (w,) with a term's amplitudes on a row.

    Args:
        nodes: (w,) float32, workspace. line: the number of the amplitudes' line.
        lines: four rows of `terms.lines`. weight: of each.
    """
    width = lines.shape[1] // (2 * len(terms.harmonic))
    if width == len(out):
        _blend(out, lines, line * width, weight)
    else:
        _blend(nodes[:width], lines, line * width, weight)
        harmonics.interpolate_line(out, nodes, terms.ends, terms.weight)


@jit_in_place
def _add_beat(out, term, sign, coefficients, h, passes):
    """Add a term to out (3, 3, w).

    Args:
        term: (5, w) float32, from PHASE on. sign: (3,). coefficients: see `records.Pattern`.
        h: its harmonic. passes: as in `fill_modulation`.
    """
    cos, sin = term[COS], term[SIN]
    for plane in range(3):
        amplitude = term[GREEN_AMPLITUDE if plane == GREEN else COLOURED_AMPLITUDE]
        for channel in range(3):
            if sign[plane] == 0 or not passes[plane, channel]:
                continue
            row = out[plane, channel]
            real = sign[plane] * coefficients[channel, h, 0]
            imaginary = sign[plane] * coefficients[channel, h, 1]
            for i in range(len(row)):
                seen = real * load(cos, i) - imaginary * load(sin, i)
                store(row, i, row[i] + load(amplitude, i) * seen)


@jit_in_place
def fill_modulation(out, work, terms, pattern, passes, position, v, first_row):
    """Fill out (3, 3, w), by colour filter and channel, with the sum of the terms on a row v.

    Args:
        work: (5, w) float32, workspace.
        terms: from `beat_terms_of`. pattern: see `records.Pattern`.
        passes: (3, 3) bool, which channels a filter passes.
        position: (4, w) float64, where the pixels look and lie, see `rows.Row`. first_row: row of
            the first nodes.
    """
    fill(out.reshape(-1), ZERO)
    node, t = bracket(v, first_row, terms.step_v, len(terms.lines), 3)
    weight, lines = harmonics.cubic_weights32(t), terms.lines[node : node + 4]
    for i in range(len(terms.harmonic)):
        peak, sign = terms.peak[node : node + 4, i], terms.sign[i]
        if max(peak[0], peak[1], peak[2], peak[3]) < terms.least_amplitude:
            continue
        _phase(work[PHASE], position, terms.wave[i])
        harmonics.fill_fundamental(work[COS], work[SIN], work[PHASE])
        _fill_amplitude(work[COLOURED_AMPLITUDE], work[PHASE], terms, 2 * i, lines, weight)
        if sign[GREEN] != 0:
            _fill_amplitude(work[GREEN_AMPLITUDE], work[PHASE], terms, 2 * i + 1, lines, weight)
        _add_beat(out, work, sign, pattern.coefficients, terms.harmonic[i], passes)
