"""The normal distribution as tables, so that no loop calls a transcendental function."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from moireaug.engine.cpu.compiling import jit_in_place
from moireaug.engine.cpu.vectors import load, store

TAIL_STEPS, TAIL_END_SIGMAS = 256, 7  # of the tables; steps per standard deviation
ONE32 = np.int32(1)

_normal = NormalDist()
_places = [i / TAIL_STEPS for i in range(TAIL_END_SIGMAS * TAIL_STEPS + 2)]


def _tail(z: float) -> float:
    """Return the integral of the distribution function from -infinity to -z; that up to z is
    max(z, 0) more."""
    return math.exp(-z * z / 2) / math.sqrt(2 * math.pi) - z * _normal.cdf(-z)


TAIL_TABLE = np.array([_tail(z) for z in _places])
CUMULATIVE_TABLE = np.array([_normal.cdf(-z) for z in _places])
DENSITY_TABLE = np.array([_normal.pdf(z) for z in _places])


@jit_in_place
def tail(z):
    """Return `_tail` at z >= 0, float64."""
    at = min(z, float(TAIL_END_SIGMAS)) * TAIL_STEPS
    i = np.int32(at)
    low = TAIL_TABLE[np.uint32(i)]
    return low + (at - i) * (TAIL_TABLE[np.uint32(np.int32(i + 1))] - low)


@jit_in_place
def integral(x, sigma):
    """Return sigma (z Phi(z) + phi(z)) at z = x / sigma, float64."""
    return max(x, 0.0) + sigma * tail(abs(x) / sigma)


@jit_in_place
def normal(z):
    """Return the normal distribution function at z and its derivative, float64."""
    at = min(abs(z), float(TAIL_END_SIGMAS)) * TAIL_STEPS
    i = np.int32(at)
    here, there, past = np.uint32(i), np.uint32(np.int32(i + 1)), at - i
    low = CUMULATIVE_TABLE[here]
    below = low + past * (CUMULATIVE_TABLE[there] - low)
    low = DENSITY_TABLE[here]
    density = low + past * (DENSITY_TABLE[there] - low)
    return (1 - below if z > 0 else below), density


@jit_in_place
def integrals(out, origin, step, sigma):
    """Fill out (n,) float64 with `integral` at multiples of a step, of which 0 is at `origin`."""
    per_sigma = TAIL_STEPS / sigma
    for i in range(len(out)):
        x = (i - origin) * step
        at = min(abs(x) * per_sigma, float(TAIL_END_SIGMAS * TAIL_STEPS))
        k = np.int32(at)
        low = load(TAIL_TABLE, k)
        beyond = low + (at - k) * (load(TAIL_TABLE, np.int32(k + ONE32)) - low)
        store(out, i, max(x, 0.0) + sigma * beyond)
