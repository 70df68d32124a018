"""The formulas of `moireaug.common.physics`, compiled by Triton."""

from __future__ import annotations

import numpy as np
import triton
import triton.language as tl

from moireaug.common.physics import srgb
from moireaug.common.physics.binding import bind

MIN_BASE = tl.constexpr(1e-6)  # of a power


@triton.jit
def _where(condition, a, b):
    return tl.where(condition, a, b)


@triton.jit
def _maximum(a, b):
    return tl.maximum(a, b)


@triton.jit
def _minimum(a, b):
    return tl.minimum(a, b)


@triton.jit
def _absolute(x):
    return tl.abs(x)


@triton.jit
def _sqrt(x):
    return tl.sqrt(x)


@triton.jit
def _ceil(x):
    return tl.ceil(x)


@triton.jit
def _power(x, exponent):
    """Return a power of x, of MIN_BASE at least."""
    return tl.exp2(tl.log2(tl.maximum(x, MIN_BASE)) * exponent)


@triton.jit
def _wrapped(x):
    return x


@triton.jit
def _shifted(x, bits):
    return x >> bits


OPERATIONS = {
    "tl": tl,  # which the interpreter looks for
    "where": _where,
    "maximum": _maximum,
    "minimum": _minimum,
    "absolute": _absolute,
    "sqrt": _sqrt,
    "ceil": _ceil,
    "power": _power,
    "wrapped": _wrapped,
    "shifted": _shifted,
    "ONE": tl.constexpr(1.0),
    "TWO": tl.constexpr(2.0),
    "SIX": tl.constexpr(6.0),
}
# a digit of float32 less than 1.055: the code of light 1 must not be above 1, where a clip has no
# slope
CODE_GAIN = float(np.nextafter(np.float32(srgb.GAIN), np.float32(0)))


def bind_for_triton(subject, **operations):
    """Return the formulas of a subject, compiled by Triton; operations: besides OPERATIONS."""
    return bind(subject, OPERATIONS | operations, triton.jit, tl.constexpr)


bins = bind_for_triton("bins")
footprint = bind_for_triton("footprint")
lens = bind_for_triton("lens")
panel = bind_for_triton("panel")
random_numbers = bind_for_triton("random_numbers")
sensor = bind_for_triton("sensor")
tone = bind_for_triton("tone")
decoding = bind_for_triton("srgb")
encoding = bind_for_triton("srgb", GAIN=tl.constexpr(CODE_GAIN))
