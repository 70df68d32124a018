"""The panel's pattern that a binned reading averages away: what saturates depends on it."""

from __future__ import annotations

import math

import numpy as np

from moireaug.engine.cpu.beat_grid import grid_at
from moireaug.engine.cpu.beat_terms import alias_transfer, plane_transfers
from moireaug.engine.cpu.compiling import jit, jit_in_place
from moireaug.engine.cpu.optics import transfer_at


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
            transfer = alias_transfer(fu, fv, m_u, m_v, side, triangle)
            coloured, green = plane_transfers(even_u, even_v, m_u, m_v, bayer)
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
