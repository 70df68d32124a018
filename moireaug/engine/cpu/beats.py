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
from moireaug.engine.cpu.compiling import fill, jit, jit_in_place, jit_inlined
from moireaug.engine.cpu.optics import transfer_at
from moireaug.engine.cpu.records import Terms
from moireaug.engine.cpu.rows import U, V, X, Y
from moireaug.engine.cpu.vectors import load, store

ONE, ZERO = np.float32(1), np.float32(0)
PER_X, PER_Y, PER_U, PER_V, IN_MIDDLE = range(5)  # columns of a wave
BLUE, GREEN = range(2)  # columns of a sign


@jit_in_place
def _fill_power_shares(out, fu, fv, bayer, side, triangle):
    """Fill out (2,) with the share of a harmonic's power that bins keep on average, in the planes
    of red and blue, and in that of green."""
    out[0] = out[1] = 0.0
    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
    for j in range(4):
        m_u = math.floor(2 * fu) - 1 + j
        for k in range(4):
            m_v = math.floor(2 * fv) - 1 + k
            transfer = beat_terms.alias_transfer(fu, fv, m_u, m_v, side, triangle)
            coloured, green = beat_terms.plane_transfers(even_u, even_v, m_u, m_v, bayer)
            out[0] += (transfer * coloured) ** 2
            out[1] += (transfer * green) ** 2


@jit_in_place
def _power_of(b, i, h, filters, plane):
    """Return the squared amplitude of a harmonic in what a filter passes."""
    real = imaginary = 0.0
    for channel in range(3):
        real += filters[plane, channel] * b.coefficients[i, channel, h, 0]
        imaginary += filters[plane, channel] * b.coefficients[i, channel, h, 1]
    return real * real + imaginary * imaginary


@jit
def lost_pattern_variance(out, b, i, filters, camera, table, steps_per_cycle):
    """Fill out (3,) float32 with the variance of the panel's pattern that bins average away in the
    middle of the reading of image i, as a share of the squared mean light, by colour filter.

    b: see `exposure_records.Beats`. table, steps_per_cycle: from `beat_grid.transfer_of`.
    """
    middle = np.zeros(1, np.float64)
    grid = grid_at(middle, middle, camera, b, i, b.orders)
    power, shares = np.zeros(3, np.float64), np.empty(2, np.float64)
    for h in range(len(b.orders)):
        fu, fv = grid.frequency[0, 0, h]
        passed = transfer_at(fu, fv, table, steps_per_cycle, camera)
        _fill_power_shares(shares, fu, fv, b.bayer, grid.sides[0, 0], grid.triangle)
        for plane in range(3):
            lost = 1 - min(shares[1 if plane == 1 else 0], 1.0)
            power[plane] += passed * passed / 2 * lost * _power_of(b, i, h, filters, plane)
    for plane in range(3):
        light = 0.0
        for channel in range(3):
            light += filters[plane, channel] * b.mean[i, channel]
        out[plane] = power[plane] / max(light * light, 1e-12)


@jit_in_place
def _fill_lines(lines, peak, amplitude, strong, ends, weight, strength):
    """Fill lines (rows, T * 2 * w) with the amplitudes of the `strong` terms at the pixels of each
    row of nodes, and peak (rows, T) with the greatest of each, times strength (T,)."""
    w = weight.shape[1]
    for r in range(len(lines)):
        for t in range(len(strong)):
            peak[r, t] = ZERO
            for plane in range(2):
                start, values = (2 * t + plane) * w, amplitude[r, :, strong[t], plane]
                harmonics.interpolate_line(lines[r, start : start + w], values, ends, weight)
                for c in range(len(values)):
                    peak[r, t] = max(peak[r, t], abs(values[c]) * strength[t])


@jit_in_place
def _fill_waves(wave, sign, terms, strong, cycles, start, camera):
    """Fill wave (T, 5) with each term's cycles per pixel of the shown panel along x and y, per
    photo pixel along u and v, and in the photo's middle; and sign (T, 2) with its sign in the
    planes of BLUE and of GREEN.

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
        sign[t, BLUE] = ONE if (m_u + m_v) % 2 == 0 else -ONE
        sign[t, GREEN] = ONE if m_u % 2 == 0 else -ONE


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
    lines = np.empty((n_v, len(strong) * 2 * w), np.float32)
    peak = np.empty((n_v, len(strong)), np.float32)
    harmonic, shown = np.empty(len(strong), np.int64), np.empty(len(strong), np.float32)
    for t in range(len(strong)):
        harmonic[t] = used[terms[strong[t], HARMONIC]]
        shown[t] = strength[terms[strong[t], HARMONIC]]
    _fill_lines(lines, peak, amplitude, strong, ends, weight, shown)
    wave, sign = np.empty((len(strong), 5), np.float64), np.empty((len(strong), 2), np.float32)
    start = b.start[i, 0] / b.ratio[i], b.start[i, 1] / b.ratio[i]
    _fill_waves(wave, sign, terms, strong, cycles, start, camera)
    lost = np.zeros(3, np.float32)
    if b.saturates:
        lost_pattern_variance(lost, b, i, filters, camera, table, steps_per_cycle)
    return Terms(harmonic, wave, sign, lines, peak, budget.beat_amplitude, step_v, lost)


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
def _blend(out, first, second, third, fourth, weight):
    wa, wb, wc, wd = weight
    for i in range(len(out)):
        low = wa * load(first, i) + wb * load(second, i)
        store(out, i, low + (wc * load(third, i) + wd * load(fourth, i)))


@jit_in_place
def _add_beat(out, amplitude, cos, sin, real, imaginary):
    for i in range(len(out)):
        seen = real * load(cos, i) - imaginary * load(sin, i)
        store(out, i, out[i] + load(amplitude, i) * seen)


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
    w = out.shape[2]
    fill(out.reshape(-1), ZERO)
    node, t = bracket(v, first_row, terms.step_v, len(terms.lines), 3)
    four = harmonics.cubic_weights32(t)
    d, cos, sin, coloured, green = work[0], work[1], work[2], work[3], work[4]
    for i in range(len(terms.harmonic)):
        peak = terms.peak[node : node + 4, i]
        if max(peak[0], peak[1], peak[2], peak[3]) < terms.least_amplitude:
            continue
        _phase(d, position, terms.wave[i])
        harmonics.fill_fundamental(cos, sin, d)
        a, b, c = 2 * i * w, (2 * i + 1) * w, (2 * i + 2) * w
        first, second = terms.lines[node], terms.lines[node + 1]
        third, fourth = terms.lines[node + 2], terms.lines[node + 3]
        _blend(coloured, first[a:b], second[a:b], third[a:b], fourth[a:b], four)
        if pattern.bayer:
            _blend(green, first[b:c], second[b:c], third[b:c], fourth[b:c], four)
        h = terms.harmonic[i]
        for plane in range(3):
            sign = ONE
            if pattern.bayer and plane > 0:
                sign = terms.sign[i, BLUE if plane == 2 else GREEN]
            for channel in range(3):
                if not passes[plane, channel]:
                    continue
                real = sign * pattern.coefficients[channel, h, 0]
                imaginary = sign * pattern.coefficients[channel, h, 1]
                if pattern.bayer and plane == 1:
                    _add_beat(out[plane, channel], green, cos, sin, real, imaginary)
                else:
                    _add_beat(out[plane, channel], coloured, cos, sin, real, imaginary)
