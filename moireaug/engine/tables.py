"""Transfer curves and the normal distribution as tables, so that no loop calls a transcendental
function."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from moireaug.engine.compiling import inner
from moireaug.engine.vectors import peek, poke

ONE, HALF, ZERO = np.float32(1), np.float32(0.5), np.float32(0)
ONE32 = np.int32(1)


def _srgb_light(code: float) -> float:
    return code / 12.92 if code <= 0.04045 else ((code + 0.055) / 1.055) ** 2.4


DECODE_STEPS = 1024
DECODE = np.array([_srgb_light(i / DECODE_STEPS) for i in range(DECODE_STEPS + 2)], np.float32)
DECODE_BYTES = np.array([_srgb_light(i / 255) for i in range(256)], np.float32)

# The encoding's power is tabulated over the mantissa of each octave from 2^-9 to 2^8, so that its
# error is relative.
KNEE = np.float32(0.0031308)
LINEAR = np.float32(12.92)
OCTAVE_BITS = 7
MANTISSA_BITS = np.int32(23 - OCTAVE_BITS)
FIRST = np.int32((127 - 9) << OCTAVE_BITS)
_octaves = np.arange(((127 + 8) << OCTAVE_BITS) - FIRST + 2, dtype=np.int32)
_light = ((_octaves + FIRST) << MANTISSA_BITS).view(np.float32).astype(np.float64)
ENCODE = (1.055 * _light ** (1 / 2.4) - 0.055).astype(np.float32)
ENCODE_SLOPE = (1.055 / 2.4 * _light ** (1 / 2.4 - 1)).astype(np.float32)
BELOW = np.int32((1 << MANTISSA_BITS) - 1)
PER_STEP = np.float32(1 / (1 << MANTISSA_BITS))
LAST = np.float32(255.9)

# the integral of the normal distribution function is max(z, 0) + tail(|z|)
TAIL_STEPS = 256
TAIL_END = 7
_normal = NormalDist()
TAIL = np.array(
    [
        math.exp(-z * z / 2) / math.sqrt(2 * math.pi) - z * _normal.cdf(-z)
        for z in (i / TAIL_STEPS for i in range(TAIL_END * TAIL_STEPS + 2))
    ]
)


@inner
def decode(code):
    """Return the light of an sRGB code in [0, 1], float32."""
    at = code * np.float32(DECODE_STEPS)
    i = np.int32(at)
    low = DECODE[np.uint32(i)]
    return low + (at - np.float32(i)) * (DECODE[np.uint32(np.int32(i + 1))] - low)


@inner
def _power(table, light):
    bits = np.float32(min(max(light, KNEE), LAST)).view(np.int32)
    i = np.int32(np.int32(bits >> MANTISSA_BITS) - FIRST)
    f = np.float32(np.int32(bits & BELOW)) * PER_STEP
    low = table[np.uint32(i)]
    return low + f * (table[np.uint32(np.int32(i + 1))] - low)


@inner
def encode(light):
    """Return the sRGB code of light up to 255, float32; the linear part goes on below zero."""
    power = _power(ENCODE, light)
    return power if light > KNEE else light * LINEAR


@inner
def encode_slope(light):
    """Return the derivative of `encode`."""
    power = _power(ENCODE_SLOPE, light)
    return power if light > KNEE else LINEAR


@inner
def tail(z):
    """Return the integral of the normal distribution function from -infinity to -z, z >= 0,
    float64."""
    at = min(z, float(TAIL_END)) * TAIL_STEPS
    i = np.int32(at)
    low = TAIL[np.uint32(i)]
    return low + (at - i) * (TAIL[np.uint32(np.int32(i + 1))] - low)


@inner
def integral(x, sigma):
    """Return sigma (z Phi(z) + phi(z)) at z = x / sigma, float64."""
    return max(x, 0.0) + sigma * tail(abs(x) / sigma)


@inner
def add_integral(out, sign, start, step, sigma):
    """Add sign * `integral` at start, start + step, ... to out (n,) float64."""
    per_sigma = TAIL_STEPS / sigma
    for i in range(len(out)):
        x = start + i * step
        at = min(abs(x) * per_sigma, float(TAIL_END * TAIL_STEPS))
        k = np.int32(at)
        low = peek(TAIL, k)
        beyond = low + (at - k) * (peek(TAIL, np.int32(k + ONE32)) - low)
        poke(out, i, out[i] + sign * (max(x, 0.0) + sigma * beyond))
