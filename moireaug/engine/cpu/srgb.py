"""sRGB codes to light by a table and back by polynomials, so that no loop calls a transcendental
function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.chebyshev import chebpts2

from moireaug.common.physics import srgb
from moireaug.common.physics.binding import bind
from moireaug.engine.cpu.compiling import jit_in_place

DECODE_STEPS = 1024  # of a table
HALF = np.float32(0.5)
# on Python's own numbers
_curve = bind(
    "srgb", {"where": lambda holds, a, b: a if holds else b, "maximum": max, "power": pow}
)
_codes = [i / DECODE_STEPS for i in range(DECODE_STEPS + 2)]
SRGB_CODE_KNEE = np.float32(srgb.CODE_KNEE)
SRGB_SLOPE_AT_BLACK = np.float32(1 / srgb.SLOPE_AT_BLACK)
DECODE_TABLE = np.array([_curve.light_of_code(code) for code in _codes], np.float32)
DECODE_SLOPE_TABLE = np.array([_curve.bent_slope(code) for code in _codes], np.float32)
DECODE_BYTE_TABLE = np.array([_curve.light_of_code(i / 255) for i in range(256)], np.float32)

# Encoding takes light to the power of 1 / 2.4: the mantissa by a polynomial, the octave as a whole
# power of 2 times a polynomial for the rest. A look-up would take twice as long.
MAX_LIGHT = np.float32(256)
SRGB_KNEE, SRGB_LINEAR_GAIN = np.float32(srgb.LIGHT_KNEE), np.float32(srgb.SLOPE_AT_BLACK)
# a digit less than 1.055: the code of light 1 must not be above 1, where a clip has no slope
SRGB_GAIN = np.nextafter(np.float32(srgb.GAIN), np.float32(0))
SRGB_OFFSET, SRGB_POWER = np.float32(srgb.OFFSET), np.float32(1 / srgb.EXPONENT)
MANTISSA_BITS, MANTISSA_MASK = np.int32(23), np.int32(2**23 - 1)
EXPONENT_BIAS, BITS_OF_ONE = np.int32(127), np.float32(1).view(np.int32)
MANTISSA_MIDDLE = np.float32(1.5)


def _polynomial(function: Callable[[np.ndarray], np.ndarray]) -> list[np.float32]:
    """Return the coefficients of a polynomial of degree 5 close to a function on [-1/2, 1/2], and
    equal to it at the ends."""
    at = chebpts2(6) / 2
    return [np.float32(c) for c in Polynomial.fit(at, function(at), 5).convert().coef]


M0, M1, M2, M3, M4, M5 = _polynomial(lambda t: (1.5 + t) ** (1 / srgb.EXPONENT))
E0, E1, E2, E3, E4, E5 = _polynomial(lambda t: 2 ** (0.5 + t))


@jit_in_place
def decode(code):
    """Return the light of an sRGB code in [0, 1], float32."""
    at = code * np.float32(DECODE_STEPS)
    i = np.int32(at)
    low = DECODE_TABLE[np.uint32(i)]
    return low + (at - np.float32(i)) * (DECODE_TABLE[np.uint32(np.int32(i + 1))] - low)


@jit_in_place
def decode_slope(code):
    """Return the derivative of the light of an sRGB code in [0, 1], float32; that of `decode`, a
    table, is a staircase."""
    at = code * np.float32(DECODE_STEPS)
    i = np.int32(at)
    low = DECODE_SLOPE_TABLE[np.uint32(i)]
    slope = low + (at - np.float32(i)) * (DECODE_SLOPE_TABLE[np.uint32(np.int32(i + 1))] - low)
    return slope if code > SRGB_CODE_KNEE else SRGB_SLOPE_AT_BLACK


@jit_in_place
def _root(light):
    """Return light ** (1 / 2.4), float32, to a relative 2e-6; light is clipped to [SRGB_KNEE,
    MAX_LIGHT]."""
    bits = np.float32(min(max(light, SRGB_KNEE), MAX_LIGHT)).view(np.int32)
    exponent = np.int32(np.int32(bits >> MANTISSA_BITS) - EXPONENT_BIAS)
    mantissa = np.int32(np.int32(bits & MANTISSA_MASK) | BITS_OF_ONE).view(np.float32)
    # mantissa ** (1 / 2.4)
    t = mantissa - MANTISSA_MIDDLE
    root = M0 + t * (M1 + t * (M2 + t * (M3 + t * (M4 + t * M5))))
    # 2 ** (exponent / 2.4)
    octaves = np.float32(exponent) * SRGB_POWER
    whole = np.floor(octaves)
    t = octaves - whole - HALF
    fraction = E0 + t * (E1 + t * (E2 + t * (E3 + t * (E4 + t * E5))))
    exponent = np.int32(np.int32(whole) + EXPONENT_BIAS)
    return root * fraction * np.int32(exponent << MANTISSA_BITS).view(np.float32)


@jit_in_place
def encode(light):
    """Return the sRGB code of light up to 256, float32; the linear part goes on below zero."""
    code = SRGB_GAIN * _root(light) - SRGB_OFFSET
    return code if light > SRGB_KNEE else light * SRGB_LINEAR_GAIN


@jit_in_place
def encode_and_slope(light):
    """Return `encode`, and its derivative, from one root."""
    root = _root(light)
    code = SRGB_GAIN * root - SRGB_OFFSET
    slope = SRGB_GAIN * SRGB_POWER * root / max(light, SRGB_KNEE)
    return (code, slope) if light > SRGB_KNEE else (light * SRGB_LINEAR_GAIN, SRGB_LINEAR_GAIN)
