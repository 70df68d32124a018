"""The terms of beats: which aliases of which harmonics a binned reading shows, and how strong they
are at nodes of the photo.

A term is a harmonic (k, l) and an alias (m_u, m_v); see `exposure.binning`.
"""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine import optics
from moireaug.engine.compiling import inner, loop
from moireaug.engine.nodes import SAMPLES, sample
from moireaug.engine.view import jacobian

FAINT_BEAT = 1e-4  # of full scale: terms that nowhere exceed it in a reading are left out
LOBE = 0.2  # how much a beat's frequency may change between two nodes, in cycles per photo pixel
BRIGHT = 0.3  # amplitude of a harmonic in a reading for which LOBE is made
UNKNOWN = 2.0  # no transfer is
SAFETY = 1.2  # how much more of a harmonic may pass between the samples
MOST_NODES, MOST_TERMS = 192, 1024
STEPS, PER_LOBE, MOST_STEPS = 256, 32, 2**14  # of the table of what is left of an alias
ZERO = np.float32(0)


@inner
def fill_frequencies(out, us, vs, camera, period, orders):
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
def sampled_frequencies(rows, cols, camera, period, orders):
    """Return the harmonics' frequencies at a few points over the photo; see
    `fill_frequencies`."""
    us, vs = np.empty(SAMPLES, np.float64), np.empty(SAMPLES, np.float64)
    for i in range(SAMPLES):
        us[i], vs[i] = sample(cols, i, SAMPLES), sample(rows, i, SAMPLES)
    out = np.empty((SAMPLES, SAMPLES, len(orders), 2), np.float64)
    fill_frequencies(out, us, vs, camera, period, orders)
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
def brightest(frequency, strength, table, steps, camera):
    """Return the most that each harmonic makes of a reading, (K,)."""
    out = np.empty(len(strength), np.float64)
    for h in range(len(strength)):
        passed = _most_transmitted(frequency, h, table, steps, camera)
        out[h] = strength[h] * passed * max(camera.gain, 1.0)
    return out


@loop
def transfer_of(frequency, camera):
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
    frequency = sampled_frequencies(sites.rows, sites.cols, camera, period, orders)
    table, steps = transfer_of(frequency, camera)
    amplitude = brightest(frequency, strength, table, steps, camera)
    across, down = node_counts(frequency, amplitude, sites, camera, scale)
    few = len(candidates(frequency, amplitude, scale)) < MOST_TERMS
    return few and max(across, down) <= MOST_NODES


@loop
def node_counts(frequency, amplitude, sites, camera, scale):
    """Return how many nodes the amplitudes need along u and v; frequency: from
    `sampled_frequencies`, amplitude: from `brightest`."""
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
def transmitted(fu, fv, table, steps, camera):
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
    """Return about the most that aperture and lens leave of a harmonic, at every fourth sample."""
    most = 0.0
    for i in range(0, SAMPLES, 4):
        for j in range(0, SAMPLES, 4):
            fu, fv = frequency[i, j, h, 0], frequency[i, j, h, 1]
            most = max(most, abs(transmitted(fu, fv, table, steps, camera)))
    return min(SAFETY * most, 1.0)


@loop
def candidates(frequency, amplitude, scale):
    """Return the terms (T, 3) int64, harmonic and alias along both axes, that may exceed
    FAINT_BEAT, MOST_TERMS where there are as many or more; amplitude: from `brightest`.

    frequency: from `sampled_frequencies`, so that its ends are about those over the photo.
    """
    count, n = 0, frequency.shape[2]
    out = np.empty((64, 3), np.int64)
    for h in range(n):
        if amplitude[h] <= FAINT_BEAT:
            continue
        (low_u, high_u), (low_v, high_v) = _range_of(frequency, h, 0), _range_of(frequency, h, 1)
        if max(high_u - low_u, high_v - low_v) > MOST_TERMS / 2:
            return np.zeros((MOST_TERMS, 3), np.int64)
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
def harmonics_of(terms):
    """Return the harmonics of sorted terms, (H,), and number the terms' own by their places."""
    out, count = np.empty(len(terms), np.int64), 0
    for t in range(len(terms)):
        if count == 0 or terms[t, 0] != out[count - 1]:
            out[count] = terms[t, 0]
            count += 1
        terms[t, 0] = count - 1
    return out[:count]


@loop
def left_table(scale, steps):
    """Return what is left of an alias g without interpolation, sinc(g) sinc(s g), at steps + 2
    values of |g| from 0 to 1 and one step beyond."""
    out, wide = np.empty(steps + 2, np.float64), max(scale, 1.0)
    for i in range(steps + 2):
        t = math.pi * i / steps
        out[i] = math.sin(t) / t * math.sin(wide * t) / (wide * t) if i > 0 else 1.0
    return out


@inner
def left_of(frequency, m, table):
    """Return what is left of an alias along one axis without interpolation."""
    g = abs(frequency - m / 2)
    return optics.transfer(table, g * (len(table) - 2)) if g < 1 else 0.0


@inner
def interpolated(even, m):
    """Return what interpolation leaves of an alias, from what it leaves of even ones."""
    return even if m % 2 == 0 else 1 - even


@loop
def fill_amplitudes(out, frequency, terms, least, left, table, steps, camera, bayer):
    """Fill out (rows, cols, T, 2) float32 with each term's amplitude at nodes, as the planes of red
    and blue, and of green, read it; without colour filters, as all do. Terms are sorted; of those
    of a harmonic that are below `least` (H,), some are 0."""
    rows, cols, n = out.shape[:3]
    for r in range(rows):
        for c in range(cols):
            last, last_u, fu, fv, passed, even_u, even_v, u = (
                -1,
                0,
                0.0,
                0.0,
                UNKNOWN,
                0.0,
                0.0,
                0.0,
            )
            for t in range(n):
                h, m_u, m_v = terms[t, 0], terms[t, 1], terms[t, 2]
                if h != last:
                    fu, fv, passed = frequency[r, c, h, 0], frequency[r, c, h, 1], UNKNOWN
                if h != last or m_u != last_u:
                    u = left_of(fu, m_u, left)
                last, last_u = h, m_u
                out[r, c, t, 0] = out[r, c, t, 1] = ZERO
                if abs(u) < least[h]:
                    continue
                if passed == UNKNOWN:
                    passed = transmitted(fu, fv, table, steps, camera)
                    even_u, even_v = math.cos(math.pi * fu) ** 2, math.cos(math.pi * fv) ** 2
                seen = passed * u * left_of(fv, m_v, left)
                in_u, in_v = interpolated(even_u, m_u), interpolated(even_v, m_v)
                even = (m_u + m_v) % 2 == 0
                if bayer:
                    out[r, c, t, 0] = seen * in_u * in_v
                    out[r, c, t, 1] = seen * (in_u + in_v) / 2 if even else 0.0
                elif even and m_u % 2 == 0:
                    out[r, c, t, 0] = seen


@loop
def strong(amplitude, terms, strength):
    """Return which terms exceed FAINT_BEAT at any node; strength: (H,), of harmonics in a
    reading."""
    rows, cols, n, _ = amplitude.shape
    out, count = np.empty(n, np.int64), 0
    for t in range(n):
        most = ZERO
        for r in range(rows):
            for c in range(cols):
                most = max(most, abs(amplitude[r, c, t, 0]), abs(amplitude[r, c, t, 1]))
        if most * strength[terms[t, 0]] > FAINT_BEAT:
            out[count] = t
            count += 1
    return out[:count]
