"""Beats: the panel's harmonics as the pixels of a binned reading see them, each alias a slow wave.

A term is a harmonic (k, l) and an alias (m_u, m_v); see `exposure.binning`. Its amplitude changes
slowly over the photo: it is computed on a grid of nodes and interpolated by cubics.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import harmonics, optics
from moireaug.engine.compiling import fill, inner, loop, part
from moireaug.engine.exposure_records import Terms
from moireaug.engine.nodes import SAMPLES, bracket, cubics, line_of, sample
from moireaug.engine.vectors import peek, poke
from moireaug.engine.view import jacobian

FAINT_BEAT = 1e-4  # of full scale: terms that nowhere exceed it in a reading are left out
LOBE = 0.2  # how much a beat's frequency may change between two nodes, in cycles per photo pixel
MOST_NODES = 192
STEPS, PER_LOBE, MOST_STEPS = 256, 32, 2**14  # of the table of what is left of an alias
HALF, ONE, TWO, ZERO = np.float32(0.5), np.float32(1), np.float32(2), np.float32(0)


@inner
def _fill_frequencies(out, us, vs, camera, period, orders):
    """Fill out (rows, cols, K, 2) with the frequency of each harmonic at photo points, along u and
    v, in cycles per sensor pixel."""
    for r in range(len(vs)):
        for c in range(len(us)):
            xu, xv, yu, yv = jacobian(us[c], vs[r], camera)
            for h in range(len(orders)):
                k, l = orders[h, 0] / period[0], orders[h, 1] / period[1]
                out[r, c, h, 0] = k * xu + l * yu
                out[r, c, h, 1] = k * xv + l * yv


@loop
def _sampled(rows, cols, camera, period, orders):
    """Return the harmonics' frequencies at a few points over the photo; see
    `_fill_frequencies`."""
    us, vs = np.empty(SAMPLES, np.float64), np.empty(SAMPLES, np.float64)
    for i in range(SAMPLES):
        us[i], vs[i] = sample(cols, i, SAMPLES), sample(rows, i, SAMPLES)
    out = np.empty((SAMPLES, SAMPLES, len(orders), 2), np.float64)
    _fill_frequencies(out, us, vs, camera, period, orders)
    return out


@loop
def _node_count(frequency, scale, axis, fewest, pixels):
    """Return how many nodes the amplitudes need along u (0) or v (1), MOST_NODES + 1 where they
    need more than MOST_NODES; no more than pixels, at which they then lie."""
    most = 0.0
    for i in range(SAMPLES):
        for j in range(SAMPLES - 1):
            for h in range(frequency.shape[2]):
                for k in range(2):
                    here, there = frequency[i, j, h, k], frequency[i, j + 1, h, k]
                    if axis == 1:
                        here, there = frequency[j, i, h, k], frequency[j + 1, i, h, k]
                    most = max(most, abs(there - here))
    lobes = most * (SAMPLES - 1) * max(scale, 1.0)
    if lobes < 1e-6:
        return 4
    return int(min(max(lobes / LOBE + 2, fewest), max(pixels, 4), MOST_NODES + 1))


@loop
def node_counts(sites, camera, scale, period, orders):
    """Return how many nodes the amplitudes need along u and v."""
    frequency = _sampled(sites.rows, sites.cols, camera, period, orders)
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    across = _node_count(frequency, scale, 0, fewest, len(sites.cols))
    return across, _node_count(frequency, scale, 1, fewest, len(sites.rows))


@inner
def _envelope(low, high, m, scale):
    """Return the most that is left of an alias m of frequencies from `low` to `high`."""
    least, greatest = low - m / 2, high - m / 2
    nearest = 0.0 if least <= 0 <= greatest else min(abs(least), abs(greatest))
    if nearest >= 1:
        return 0.0
    return min(1.0, 1 / (math.pi * max(scale, 1.0) * nearest + 1e-9)) * (1 - nearest * nearest)


@inner
def _transmitted(fu, fv, table, steps, camera):
    """Return what aperture and lens leave of a frequency."""
    passed = optics.transfer(table, abs(fu) * steps) * optics.transfer(table, abs(fv) * steps)
    if camera.motion_x != 0 or camera.motion_y != 0:
        along = fu * camera.motion_x + fv * camera.motion_y
        passed *= math.exp(-2 * math.pi * math.pi * along * along)
    return passed


@loop
def _doubled(terms):
    """Return terms (T, 3) with room for as many more."""
    out = np.empty((2 * len(terms), 3), np.int64)
    for t in range(len(terms)):
        for j in range(3):
            out[t, j] = terms[t, j]
    return out


@inner
def _range_of(frequency, h, axis):
    """Return the lowest and the highest frequency of a harmonic along an axis."""
    low = high = frequency[0, 0, h, axis]
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            low = min(low, frequency[i, j, h, axis])
            high = max(high, frequency[i, j, h, axis])
    return low, high


@inner
def _most_transmitted(frequency, h, table, steps, camera):
    """Return the most that aperture and lens leave of a harmonic."""
    most = 0.0
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            fu, fv = frequency[i, j, h, 0], frequency[i, j, h, 1]
            most = max(most, abs(_transmitted(fu, fv, table, steps, camera)))
    return most


@loop
def _candidates(frequency, strength, table, steps, camera, scale):
    """Return the terms (T, 3) int64, harmonic and alias along both axes, that may exceed
    FAINT_BEAT; strength: (K,), of each harmonic in its strongest colour.

    frequency: from `_sampled`, so that its ends are about those over the photo.
    """
    count, n = 0, frequency.shape[2]
    out = np.empty((64, 3), np.int64)
    for h in range(n):
        (low_u, high_u), (low_v, high_v) = _range_of(frequency, h, 0), _range_of(frequency, h, 1)
        passed = _most_transmitted(frequency, h, table, steps, camera)
        least = FAINT_BEAT / max(camera.gain, 1.0) / max(strength[h] * passed, 1e-30)
        for m_u in range(math.floor(2 * low_u) - 1, math.floor(2 * high_u) + 3):
            left = _envelope(low_u, high_u, m_u, scale)
            if left <= least:
                continue
            for m_v in range(math.floor(2 * low_v) - 1, math.floor(2 * high_v) + 3):
                if left * _envelope(low_v, high_v, m_v, scale) <= least:
                    continue
                if count == len(out):
                    out = _doubled(out)
                out[count, 0], out[count, 1], out[count, 2] = h, m_u, m_v
                count += 1
    return out[:count]


@loop
def _left_table(scale, steps):
    """Return what is left of an alias g without interpolation, sinc(g) sinc(s g), at steps + 2
    values of |g| from 0 to 1 and one step beyond."""
    out, wide = np.empty(steps + 2, np.float64), max(scale, 1.0)
    for i in range(steps + 2):
        t = math.pi * i / steps
        out[i] = math.sin(t) / t * math.sin(wide * t) / (wide * t) if i > 0 else 1.0
    return out


@inner
def _axis(frequency, m, table):
    """Return what is left of an alias along one axis without interpolation, and the factor of
    interpolation."""
    g, steps = abs(frequency - m / 2), len(table) - 2
    if g >= 1:
        return 0.0, 0.0
    c = math.cos(math.pi * g)
    return optics.transfer(table, g * steps), c * c


@loop
def _fill_amplitudes(out, frequency, terms, left, table, steps, camera, bayer):
    """Fill out (rows, cols, T, 2) float32 with each term's amplitude at nodes, as the planes of red
    and blue, and of green, read it; without colour filters, as all do."""
    rows, cols, n = out.shape[:3]
    for r in range(rows):
        for c in range(cols):
            last, passed = -1, 0.0
            for t in range(n):
                h = terms[t, 0]
                fu, fv = frequency[r, c, h, 0], frequency[r, c, h, 1]
                if h != last:
                    last, passed = h, _transmitted(fu, fv, table, steps, camera)
                u, in_u = _axis(fu, terms[t, 1], left)
                v, in_v = _axis(fv, terms[t, 2], left)
                seen = passed * u * v
                even = (terms[t, 1] + terms[t, 2]) % 2 == 0
                if bayer:
                    out[r, c, t, 0] = seen * in_u * in_v
                    out[r, c, t, 1] = seen * (in_u + in_v) / 2 if even else 0.0
                else:
                    whole = even and terms[t, 1] % 2 == 0
                    out[r, c, t, 0] = seen if whole else 0.0
                    out[r, c, t, 1] = 0.0


@loop
def _strong(amplitude, terms, strength, gain):
    """Return which terms exceed FAINT_BEAT at any node."""
    rows, cols, n, _ = amplitude.shape
    out, count = np.empty(n, np.int64), 0
    for t in range(n):
        most = ZERO
        for r in range(rows):
            for c in range(cols):
                most = max(most, abs(amplitude[r, c, t, 0]), abs(amplitude[r, c, t, 1]))
        if most * strength[terms[t, 0]] * max(gain, 1.0) > FAINT_BEAT:
            out[count] = t
            count += 1
    return out[:count]


@inner
def _add_scaled(out, weight, value):
    for i in range(len(out)):
        poke(out, i, out[i] + peek(weight, i) * value)


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
                        _add_scaled(line[low:high], weight[i, low:high], value)


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


@part
def prepare(b, i, camera, size, sites):
    """Return the Terms of image i; b: see `exposure_records.Beats`. camera: of its sensor."""
    scale, period, orders, strength = b.scale[i], b.period, b.orders, b.strength[i]
    rough = _sampled(sites.rows, sites.cols, camera, period, orders)
    most = 1e-9
    for r in range(SAMPLES):
        for c in range(SAMPLES):
            for h in range(len(orders)):
                most = max(most, abs(rough[r, c, h, 0]), abs(rough[r, c, h, 1]))
    most *= 1.25  # nodes may see a little more than the samples
    count = min(max(optics.STEPS, int(optics.PER_CYCLE * most)), optics.MOST_STEPS)
    table, steps = optics.transfer_table(camera, most, count), count / most
    terms = _candidates(rough, strength, table, steps, camera, scale)
    n_u, n_v = node_counts(sites, camera, scale, period, orders)
    us, step_u = line_of(sites.cols, n_u)
    vs, step_v = line_of(sites.rows, n_v)
    frequency = np.empty((n_v, n_u, len(orders), 2), np.float64)
    _fill_frequencies(frequency, us, vs, camera, period, orders)
    left = _left_table(scale, min(max(STEPS, int(PER_LOBE * scale)), MOST_STEPS))
    amplitude = np.empty((n_v, n_u, len(terms), 2), np.float32)
    _fill_amplitudes(amplitude, frequency, terms, left, table, steps, camera, b.bayer)
    kept = _strong(amplitude, terms, strength, camera.gain)
    w = len(sites.cols)
    ends, weight = np.empty(n_u - 2, np.int64), np.empty((4, w), np.float32)
    cubics(ends, weight, sites.cols, us[0], step_u)
    lines = np.empty((n_v, len(kept) * 2 * w), np.float32)
    peak = np.empty((n_v, len(kept)), np.float32)
    harmonic, shown = np.empty(len(kept), np.int64), np.empty(len(kept), np.float32)
    for t in range(len(kept)):
        harmonic[t] = terms[kept[t], 0]
        shown[t] = strength[harmonic[t]] * max(camera.gain, 1.0)
    _fill_lines(lines, peak, amplitude, kept, ends, weight, shown)
    wave, sign = np.empty((len(kept), 5), np.float64), np.empty((len(kept), 2), np.float32)
    _fill_waves(wave, sign, terms, kept, orders, period, b.ratio[i], scale, sites, size)
    return Terms(harmonic, wave, sign, lines, peak, step_v)


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
