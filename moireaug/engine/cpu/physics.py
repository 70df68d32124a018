"""The formulas of `moireaug.common.physics`, compiled by numba."""

from __future__ import annotations

import math

import numpy as np

from moireaug.common.physics.binding import bind
from moireaug.engine.cpu.compiling import jit_in_place


@jit_in_place
def _where(condition, a, b):
    return a if condition else b


@jit_in_place
def _shifted(x, bits):
    return np.uint32(x >> np.uint32(bits))


@jit_in_place
def _cos_pi(x):
    return math.cos(math.pi * x)


OPERATIONS = {
    "where": _where,
    "maximum": max,
    "minimum": min,
    "absolute": abs,
    "sqrt": math.sqrt,
    "ceil": math.ceil,
    "cos_pi": _cos_pi,
    "wrapped": np.uint32,  # numba would widen to 64 bits
    "shifted": _shifted,
    "ONE": np.float32(1),
    "TWO": np.float32(2),
    "SIX": np.float32(6),
}
bins = bind("bins", OPERATIONS, jit_in_place)
footprint = bind("footprint", OPERATIONS, jit_in_place)
lens = bind("lens", OPERATIONS, jit_in_place)
optics = bind("optics", OPERATIONS, jit_in_place)
panel = bind("panel", OPERATIONS, jit_in_place)
sensor = bind("sensor", OPERATIONS, jit_in_place)
tone = bind("tone", OPERATIONS, jit_in_place)
random_numbers = bind("random_numbers", OPERATIONS, jit_in_place, np.uint32)
