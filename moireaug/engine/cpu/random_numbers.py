"""The numbers of `moireaug.camera.effects.random_numbers`, a row at a time."""

from __future__ import annotations

import numpy as np

from moireaug.camera.effects.random_numbers import (
    INTERVALS,
    PLACES_PER_INTERVAL,
    quantiles,
)
from moireaug.engine.cpu.compiling import jit_in_place, jit_in_place_exact
from moireaug.engine.cpu.physics import random_numbers
from moireaug.engine.cpu.vectors import load, store

# compile-time constants: the compiler then knows that no row it writes overlaps them, and
# vectorises
LOW_QUANTILE, QUANTILE_STEP = (table.numpy() for table in quantiles())
INTERVAL_SHIFT = np.uint32(PLACES_PER_INTERVAL.bit_length() - 1)
PLACE_MASK = np.uint32(PLACES_PER_INTERVAL - 1)
INTERVAL_MASK = np.uint32(INTERVALS - 1)


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
