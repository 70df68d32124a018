"""Beats: the panel's harmonics as the pixels of a binned reading see them, each alias a slow wave.

The amplitude of a term changes slowly over the photo: it is computed on a grid of nodes and
interpolated by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import harmonics
from moireaug.engine.beat_terms import (
    FAINT_BEAT,
    MOST_STEPS,
    PER_LOBE,
    STEPS,
    brightest,
    candidates,
    fill_amplitudes,
    fill_frequencies,
    harmonics_of,
    interpolated,
    left_of,
    left_table,
    node_counts,
    sampled_frequencies,
    strong,
    transfer_of,
    transmitted,
)
from moireaug.engine.compiling import fill, inner, loop, part
from moireaug.engine.exposure_records import Terms
from moireaug.engine.nodes import bracket, cubics, line_of
from moireaug.engine.vectors import peek, poke

ONE, ZERO = np.float32(1), np.float32(0)


@inner
def _fill_lines(lines, peak, amplitude, kept, ends, weight, strength):
    """Fill lines (rows, T * 2 * w) with the kept terms' amplitudes at the pixels of each row of
    nodes, and peak (rows, T) with what the greatest makes of a reading; strength: (T,)."""
    w = weight.shape[1]
    for r in range(len(lines)):
        for t in range(len(kept)):
            peak[r, t] = ZERO
            for plane in range(2):
                start = (2 * t + plane) * w
                line = lines[r, start : start + w]
                fill(line, ZERO)
                for j in range(len(ends) - 1):
                    low, high = ends[j], ends[j + 1]
                    for i in range(4):
                        value = amplitude[r, j + i, kept[t], plane]
                        peak[r, t] = max(peak[r, t], abs(value) * strength[t])
                        harmonics.add_scaled(line[low:high], weight[i, low:high], value)


@inner
def _fill_waves(wave, sign, terms, kept, orders, period, ratio, scale, sites, size):
    """Fill wave (T, 5) with each term's cycles per pixel of the shown panel along x and y, per
    photo pixel along u and v, and in the photo's middle; and sign (T, 2) with the signs that the
    planes of blue and of green see it with."""
    for t in range(len(kept)):
        h, m_u, m_v = terms[kept[t], 0], terms[kept[t], 1], terms[kept[t], 2]
        wave[t, 0] = orders[h, 0] / period[0] * ratio
        wave[t, 1] = orders[h, 1] / period[1] * ratio
        wave[t, 2], wave[t, 3] = -m_u * scale / 2, -m_v * scale / 2
        first = m_u * (scale * size[1] / 2 - 0.5) + m_v * (scale * size[0] / 2 - 0.5)
        wave[t, 4] = -first / 2
        sign[t, 0] = ONE if (m_u + m_v) % 2 == 0 else -ONE
        sign[t, 1] = ONE if m_u % 2 == 0 else -ONE


@inner
def _left_of_power(fu, fv, plane, bayer, left):
    """Return which share of a harmonic's power the pixels of a plane keep in a bin, on average over
    where the bin lies."""
    total = 0.0
    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
    for j in range(4):
        m_u = math.floor(2 * fu) - 1 + j
        u, in_u = left_of(fu, m_u, left), interpolated(even_u, m_u)
        for k in range(4):
            m_v = math.floor(2 * fv) - 1 + k
            seen, in_v = u * left_of(fv, m_v, left), interpolated(even_v, m_v)
            even = (m_u + m_v) % 2 == 0
            if not bayer:
                seen = seen if even and m_u % 2 == 0 else 0.0
            elif plane == 1:
                seen = seen * (in_u + in_v) / 2 if even else 0.0
            else:
                seen *= in_u * in_v
            total += seen * seen
    return min(total, 1.0)


@loop
def _fill_pattern(out, b, i, frequency, filters, left, table, steps, camera):
    """Fill out (3,) with the variance of the panel's pattern that is averaged away in the middle of
    the photo, as a share of the squared mean light, by colour filter; frequency: (K, 2)."""
    for plane in range(3):
        light, power = 0.0, 0.0
        for channel in range(3):
            light += filters[plane, channel] * b.mean[i, channel]
        for h in range(len(frequency)):
            real = imaginary = 0.0
            for channel in range(3):
                real += filters[plane, channel] * b.coefficients[i, channel, h, 0]
                imaginary += filters[plane, channel] * b.coefficients[i, channel, h, 1]
            fu, fv = frequency[h, 0], frequency[h, 1]
            passed = transmitted(fu, fv, table, steps, camera)
            lost = 1 - _left_of_power(fu, fv, plane, b.bayer, left)
            power += passed * passed / 2 * lost * (real * real + imaginary * imaginary)
        out[plane] = power / max(light * light, 1e-12)


@part
def prepare(b, i, camera, filters, size, sites):
    """Return the Terms of image i; b: see `exposure_records.Beats`. camera: of its sensor."""
    scale, period, orders = b.scale[i], b.period, b.orders
    rough = sampled_frequencies(sites.rows, sites.cols, camera, period, orders)
    table, steps = transfer_of(rough, camera)
    most = brightest(rough, b.strength[i], table, steps, camera)
    terms = candidates(rough, most, scale)
    used = harmonics_of(terms)
    own, strength = np.empty((len(used), 2), np.int64), np.empty(len(used), np.float64)
    least = np.empty(len(used), np.float64)
    for h in range(len(used)):
        own[h, 0], own[h, 1] = orders[used[h], 0], orders[used[h], 1]
        strength[h] = b.strength[i, used[h]] * max(camera.gain, 1.0)
        least[h] = FAINT_BEAT / 8 / strength[h]
    n_u, n_v = node_counts(rough, most, sites, camera, scale)
    us, step_u = line_of(sites.cols, n_u)
    vs, step_v = line_of(sites.rows, n_v)
    frequency = np.empty((n_v, n_u, len(used), 2), np.float64)
    fill_frequencies(frequency, us, vs, camera, period, own)
    left = left_table(scale, min(max(STEPS, int(PER_LOBE * scale)), MOST_STEPS))
    amplitude = np.empty((n_v, n_u, len(terms), 2), np.float32)
    fill_amplitudes(amplitude, frequency, terms, least, left, table, steps, camera, b.bayer)
    kept = strong(amplitude, terms, strength)
    w = len(sites.cols)
    ends, weight = np.empty(n_u - 2, np.int64), np.empty((4, w), np.float32)
    cubics(ends, weight, sites.cols, us[0], step_u)
    lines = np.empty((n_v, len(kept) * 2 * w), np.float32)
    peak = np.empty((n_v, len(kept)), np.float32)
    harmonic, shown = np.empty(len(kept), np.int64), np.empty(len(kept), np.float32)
    for t in range(len(kept)):
        harmonic[t] = used[terms[kept[t], 0]]
        shown[t] = strength[terms[kept[t], 0]]
    _fill_lines(lines, peak, amplitude, kept, ends, weight, shown)
    wave, sign = np.empty((len(kept), 5), np.float64), np.empty((len(kept), 2), np.float32)
    _fill_waves(wave, sign, terms, kept, own, period, b.ratio[i], scale, sites, size)
    pattern = np.empty(3, np.float32)
    middle = np.zeros(1, np.float64)
    centre = np.empty((1, 1, len(orders), 2), np.float64)
    fill_frequencies(centre, middle, middle, camera, period, orders)
    _fill_pattern(pattern, b, i, centre[0, 0], filters, left, table, steps, camera)
    return Terms(harmonic, wave, sign, lines, peak, step_v, pattern)


@inner
def _phase(out, x, y, u, per_x, per_y, per_u, first):
    for i in range(len(out)):
        cycles = per_x * peek(x, i) + per_y * peek(y, i) + (per_u * peek(u, i) + first)
        poke(out, i, np.float32(cycles - math.floor(cycles + 0.5)))


@inner
def _blend(out, first, second, third, fourth, weight):
    wa, wb, wc, wd = weight
    for i in range(len(out)):
        low = wa * peek(first, i) + wb * peek(second, i)
        poke(out, i, low + (wc * peek(third, i) + wd * peek(fourth, i)))


@inner
def _add_beat(out, amplitude, cos, sin, real, imaginary):
    for i in range(len(out)):
        seen = real * peek(cos, i) - imaginary * peek(sin, i)
        poke(out, i, out[i] + peek(amplitude, i) * seen)


@inner
def modulate(out, work, weight, terms, coefficients, asked, x, y, u, v, first_row, bayer):
    """Fill out (3, 3, w), by filter and channel, with the sum of the terms on a row v.

    Args:
        work: (5, w) float32 and weight: (4,) float32, workspaces.
        terms: from `prepare`. coefficients: (3, K, 2) float32, of each channel's harmonics.
        asked: (3, 3), which channels a filter passes. x, y, u: (w,) float64, where the pixels look
            and lie; first_row: photo row of the first node.
    """
    w = len(u)
    fill(out.reshape(-1), ZERO)
    rows = len(terms.lines)
    node, t = bracket(v, first_row, terms.step_v, rows, 3)
    harmonics.lagrange(weight, t)
    four = weight[0], weight[1], weight[2], weight[3]
    d, cos, sin, coloured, green = work[0], work[1], work[2], work[3], work[4]
    for i in range(len(terms.harmonic)):
        most = max(
            max(terms.peak[node, i], terms.peak[node + 1, i]),
            max(terms.peak[node + 2, i], terms.peak[node + 3, i]),
        )
        if most < FAINT_BEAT:
            continue
        wave = terms.wave[i]
        _phase(d, x, y, u, wave[0], wave[1], wave[2], wave[3] * v + wave[4])
        harmonics.first_wave(cos, sin, d)
        a, b, c = 2 * i * w, (2 * i + 1) * w, (2 * i + 2) * w
        first, second = terms.lines[node], terms.lines[node + 1]
        third, fourth = terms.lines[node + 2], terms.lines[node + 3]
        _blend(coloured, first[a:b], second[a:b], third[a:b], fourth[a:b], four)
        if bayer:
            _blend(green, first[b:c], second[b:c], third[b:c], fourth[b:c], four)
        h = terms.harmonic[i]
        for plane in range(3):
            sign = ONE
            if bayer and plane > 0:
                sign = terms.sign[i, 0] if plane == 2 else terms.sign[i, 1]
            for channel in range(3):
                if not asked[plane, channel]:
                    continue
                real = sign * coefficients[channel, h, 0]
                imaginary = sign * coefficients[channel, h, 1]
                if bayer and plane == 1:
                    _add_beat(out[plane, channel], green, cos, sin, real, imaginary)
                else:
                    _add_beat(out[plane, channel], coloured, cos, sin, real, imaginary)
