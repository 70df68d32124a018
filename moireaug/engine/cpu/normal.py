"""The normal distribution as tables, so that no loop calls a transcendental function; and the
numbers of `moireaug.camera.effects.random_numbers`, a row at a time."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from moireaug.camera.effects.random_numbers import INTERVALS, PLACES_PER_INTERVAL, quantiles
from moireaug.engine.cpu.compiling import jit_in_place, jit_in_place_exact
from moireaug.engine.cpu.physics import random_numbers
from moireaug.engine.cpu.vectors import load, store

TAIL_STEPS, TAIL_END_SIGMAS = 256, 7  # of the tables; steps per standard deviation
ONE32 = np.int32(1)

_normal = NormalDist()
_places = [i / TAIL_STEPS for i in range(TAIL_END_SIGMAS * TAIL_STEPS + 2)]
# compile-time constants: the compiler then knows that no row it writes overlaps them, and
# vectorises
LOW_QUANTILE, QUANTILE_STEP = (table.numpy() for table in quantiles())
INTERVAL_SHIFT = np.uint32(PLACES_PER_INTERVAL.bit_length() - 1)
PLACE_MASK = np.uint32(PLACES_PER_INTERVAL - 1)
INTERVAL_MASK = np.uint32(INTERVALS - 1)


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


@jit_in_place
def _hash(bits, start, first, second):
    """Fill bits (n,) int32 with those of the numbers `start`, `start` + 1, ... of an image."""
    for i in range(len(bits)):
        keyed = np.uint32(random_numbers.mix(np.uint32(np.uint32(start + i) + first)) ^ second)
        store(bits, i, np.int32(random_numbers.mix(keyed)))


@jit_in_place_exact
def normal_row(out, bits, start, first, second):
    """Fill out (n,) float32 with the standard normal numbers `start`, `start` + 1, ... of an image,
    from its two keys, uint32; bits: (n,) int32 workspace."""
    # in a loop without look-ups, which vectorises
    _hash(bits, start, first, second)
    for i in range(len(out)):
        drawn = np.uint32(load(bits, i))
        interval = np.uint32(drawn >> INTERVAL_SHIFT) & INTERVAL_MASK
        place = np.float32(np.int32(drawn & PLACE_MASK))
        store(out, i, load(LOW_QUANTILE, interval) + load(QUANTILE_STEP, interval) * place)
