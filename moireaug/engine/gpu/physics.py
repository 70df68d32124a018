"""The formulas of `moireaug.common.physics`, compiled by Triton."""

from __future__ import annotations

import numpy as np
import triton
import triton.language as tl

from moireaug.common.physics import srgb
from moireaug.common.physics.binding import bind

MIN_BASE = tl.constexpr(1e-6)  # of a power


@triton.jit
def where(condition, a, b):
    """Return one of two values."""
    return tl.where(condition, a, b)


@triton.jit
def maximum(a, b):
    """Return the greater value."""
    return tl.maximum(a, b)


@triton.jit
def minimum(a, b):
    """Return the lesser value."""
    return tl.minimum(a, b)


@triton.jit
def absolute(x):
    """Return a magnitude."""
    return tl.abs(x)


@triton.jit
def sqrt(x):
    """Return a square root."""
    return tl.sqrt(x)


@triton.jit
def ceil(x):
    """Return the next whole number."""
    return tl.ceil(x)


@triton.jit
def power(x, exponent):
    """Return a power of x, of MIN_BASE at least."""
    return tl.exp2(tl.log2(tl.maximum(x, MIN_BASE)) * exponent)


@triton.jit
def wrapped(x):
    """Return a uint32 as it is."""
    return x


@triton.jit
def shifted(x, bits):
    """Return a uint32, shifted right."""
    return x >> bits


OPERATIONS = {
    "tl": tl,  # which the interpreter looks for
    "where": where,
    "maximum": maximum,
    "minimum": minimum,
    "absolute": absolute,
    "sqrt": sqrt,
    "ceil": ceil,
    "power": power,
    "wrapped": wrapped,
    "shifted": shifted,
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
