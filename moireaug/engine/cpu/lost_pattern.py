"""The panel's pattern that bins average away, of which saturation takes a part."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.cpu import beat_terms
from moireaug.engine.cpu.beat_grid import fill_bin
from moireaug.engine.cpu.compiling import jit, jit_in_place
from moireaug.engine.cpu.optics import transfer_at, transfer_steps, transfer_table
from moireaug.engine.cpu.physics import lens
from moireaug.engine.cpu.view import to_photo


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
    u, v, half_w, half_h = 0.0, 0.0, camera.photo_width / 2, camera.photo_height / 2
    if camera.rectified != 0:
        u, v = to_photo(u, v, camera)
    # of a picture whose middle lies off the photo, at the photo's nearest edge
    u, v = min(max(u, -half_w), half_w), min(max(v, -half_h), half_h)
    frequency, side = np.empty((len(b.orders), 2), np.float64), np.empty(4, np.float64)
    fill_bin(frequency, side, lens.panel_jacobian(u, v, camera), camera, b, i, b.orders)
    most = 0.0
    for h in range(len(frequency)):
        most = max(most, abs(frequency[h, 0]), abs(frequency[h, 1]))
    if most * steps_per_cycle > len(table):  # a part may see the panel larger than the middle does
        steps = transfer_steps(most)
        table, steps_per_cycle = transfer_table(camera, most, steps), steps / most
    power, shares = np.zeros(3, np.float64), np.empty(2, np.float64)
    for h in range(len(b.orders)):
        fu, fv = frequency[h]
        passed = transfer_at(fu, fv, table, steps_per_cycle, camera)
        _fill_power_shares(shares, fu, fv, b.bayer, side, b.triangle[i])
        for plane in range(3):
            lost = 1 - min(shares[1 if plane == 1 else 0], 1.0)
            power[plane] += passed * passed / 2 * lost * _power_of(b, i, h, filters, plane)
    for plane in range(3):
        light = 0.0
        for channel in range(3):
            light += filters[plane, channel] * b.mean[i, channel]
        out[plane] = power[plane] / max(light * light, 1e-12)
