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

FAINT_BEAT = 2e-4  # of full scale: terms that nowhere exceed it in a reading are left out
LOBE = 0.2  # how much a beat's frequency may change between two nodes, in cycles per photo pixel
BRIGHT = 0.3  # amplitude of a harmonic in a reading for which LOBE is made
MOST_NODES, MOST_TERMS = 192, 1024
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


@inner
def _fastest(frequency, amplitude, axis):
    """Return how many times the nodes' step the amplitudes change along u (0) or v (1), if they do
    so over the whole photo as where they change fastest, for one lobe per photo pixel's cycle.

    amplitude: (K,), of harmonics in a reading. The error of a cubic grows with the fourth power of
    the step: fainter ones need fewer nodes.
    """
    most = 0.0
    for h in range(frequency.shape[2]):
        if amplitude[h] < FAINT_BEAT:
            continue
        weight = min(amplitude[h] / BRIGHT, 1.0) ** 0.25
        for i in range(SAMPLES):
            for j in range(SAMPLES - 1):
                for k in range(2):
                    here, there = frequency[i, j, h, k], frequency[i, j + 1, h, k]
                    if axis == 1:
                        here, there = frequency[j, i, h, k], frequency[j + 1, i, h, k]
                    most = max(most, weight * abs(there - here))
    return most * (SAMPLES - 1)


@inner
def _node_count(change, fewest, pixels):
    """Return how many nodes a change needs, MOST_NODES + 1 if more than MOST_NODES; no more than
    pixels, at which they then lie."""
    if change < 1e-6:
        return 4
    return int(min(max(change / LOBE + 2, fewest), max(pixels, 4), MOST_NODES + 1))


@loop
def _amplitudes(frequency, strength, table, steps, camera):
    """Return the most that each harmonic makes of a reading, (K,)."""
    out = np.empty(len(strength), np.float64)
    for h in range(len(strength)):
        passed = _most_transmitted(frequency, h, table, steps, camera)
        out[h] = strength[h] * passed * max(camera.gain, 1.0)
    return out


@loop
def _table_of(frequency, camera):
    """Return the modulation transfer for frequencies up to a little more than those sampled, and
    how many of its steps a cycle per sensor pixel is."""
    most = 1e-9
    for r in range(SAMPLES):
        for c in range(SAMPLES):
            for h in range(frequency.shape[2]):
                most = max(most, abs(frequency[r, c, h, 0]), abs(frequency[r, c, h, 1]))
    most *= 1.25
    count = min(max(optics.STEPS, int(optics.PER_CYCLE * most)), optics.MOST_STEPS)
    return optics.transfer_table(camera, most, count), count / most


@loop
def fits(sites, camera, scale, period, orders, strength):
    """Return whether the kernels can follow a view: not one whose beats change too fast, or are too
    many."""
    frequency = _sampled(sites.rows, sites.cols, camera, period, orders)
    table, steps = _table_of(frequency, camera)
    amplitude = _amplitudes(frequency, strength, table, steps, camera)
    across, down = node_counts(sites, camera, scale, period, orders, strength)
    few = len(_candidates(frequency, amplitude, scale)) < MOST_TERMS
    return few and max(across, down) <= MOST_NODES


@loop
def node_counts(sites, camera, scale, period, orders, strength):
    """Return how many nodes the amplitudes need along u and v."""
    frequency = _sampled(sites.rows, sites.cols, camera, period, orders)
    table, steps = _table_of(frequency, camera)
    amplitude = _amplitudes(frequency, strength, table, steps, camera)
    fewest = 9 if camera.k1 != 0 or camera.k2 != 0 else 6
    wide = max(scale, 1.0)
    across = _node_count(wide * _fastest(frequency, amplitude, 0), fewest, len(sites.cols))
    return across, _node_count(wide * _fastest(frequency, amplitude, 1), fewest, len(sites.rows))


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
def _candidates(frequency, amplitude, scale):
    """Return the terms (T, 3) int64, harmonic and alias along both axes, that may exceed
    FAINT_BEAT; amplitude: from `_amplitudes`.

    frequency: from `_sampled`, so that its ends are about those over the photo.
    """
    count, n = 0, frequency.shape[2]
    out = np.empty((64, 3), np.int64)
    for h in range(n):
        (low_u, high_u), (low_v, high_v) = _range_of(frequency, h, 0), _range_of(frequency, h, 1)
        least = FAINT_BEAT / max(amplitude[h], 1e-30)
        for m_u in range(math.floor(2 * low_u) - 1, math.floor(2 * high_u) + 3):
            left = _envelope(low_u, high_u, m_u, scale)
            if left <= least:
                continue
            for m_v in range(math.floor(2 * low_v) - 1, math.floor(2 * high_v) + 3):
                if left * _envelope(low_v, high_v, m_v, scale) <= least:
                    continue
                if count == MOST_TERMS:
                    return out
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
def _left(frequency, m, table):
    """Return what is left of an alias along one axis without interpolation."""
    g = abs(frequency - m / 2)
    return optics.transfer(table, g * (len(table) - 2)) if g < 1 else 0.0


@inner
def _interpolated(even, m):
    """Return what interpolation leaves of an alias, from what it leaves of even ones."""
    return even if m % 2 == 0 else 1 - even


@loop
def _fill_amplitudes(out, frequency, terms, left, table, steps, camera, bayer):
    """Fill out (rows, cols, T, 2) float32 with each term's amplitude at nodes, as the planes of red
    and blue, and of green, read it; without colour filters, as all do. Terms are sorted."""
    rows, cols, n = out.shape[:3]
    for r in range(rows):
        for c in range(cols):
            last, last_u, fu, fv, passed, even_u, even_v, u = -1, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for t in range(n):
                h, m_u, m_v = terms[t, 0], terms[t, 1], terms[t, 2]
                if h != last:
                    fu, fv = frequency[r, c, h, 0], frequency[r, c, h, 1]
                    passed = _transmitted(fu, fv, table, steps, camera)
                    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
                if h != last or m_u != last_u:
                    u = passed * _left(fu, m_u, left)
                last, last_u = h, m_u
                seen = u * _left(fv, m_v, left)
                in_u, in_v = _interpolated(even_u, m_u), _interpolated(even_v, m_v)
                even = (m_u + m_v) % 2 == 0
                if bayer:
                    out[r, c, t, 0] = seen * in_u * in_v
                    out[r, c, t, 1] = seen * (in_u + in_v) / 2 if even else 0.0
                else:
                    out[r, c, t, 0] = seen if even and m_u % 2 == 0 else 0.0
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


@inner
def _left_of_power(fu, fv, plane, bayer, left):
    """Return which share of a harmonic's power the pixels of a plane keep in a bin, on average over
    where the bin lies."""
    total = 0.0
    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
    for j in range(4):
        m_u = math.floor(2 * fu) - 1 + j
        u, in_u = _left(fu, m_u, left), _interpolated(even_u, m_u)
        for k in range(4):
            m_v = math.floor(2 * fv) - 1 + k
            seen, in_v = u * _left(fv, m_v, left), _interpolated(even_v, m_v)
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
            passed = _transmitted(fu, fv, table, steps, camera)
            lost = 1 - _left_of_power(fu, fv, plane, b.bayer, left)
            power += passed * passed / 2 * lost * (real * real + imaginary * imaginary)
        out[plane] = power / max(light * light, 1e-12)


@part
def prepare(b, i, camera, filters, size, sites):
    """Return the Terms of image i; b: see `exposure_records.Beats`. camera: of its sensor."""
    scale, period, orders, strength = b.scale[i], b.period, b.orders, b.strength[i]
    rough = _sampled(sites.rows, sites.cols, camera, period, orders)
    table, steps = _table_of(rough, camera)
    brightest = _amplitudes(rough, strength, table, steps, camera)
    terms = _candidates(rough, brightest, scale)
    n_u, n_v = node_counts(sites, camera, scale, period, orders, strength)
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
    pattern = np.empty(3, np.float32)
    middle = np.zeros(1, np.float64)
    centre = np.empty((1, 1, len(orders), 2), np.float64)
    _fill_frequencies(centre, middle, middle, camera, period, orders)
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
