"""From a pixel's light to codes: white balance, colour matrix, sRGB, tone curve and brightness; and
the gradient on the way back."""

from __future__ import annotations

import triton
import triton.language as tl

SRGB_KNEE = tl.constexpr(0.0031308)
SRGB_LINEAR_GAIN = tl.constexpr(12.92)
# a digit of float32 less than 1.055: the code of light 1 must not be above 1, where a clip has no
# slope
SRGB_GAIN = tl.constexpr(1.0549999)
SRGB_OFFSET = tl.constexpr(0.055)
SRGB_POWER = tl.constexpr(1 / 2.4)


@triton.jit
def root(light):
    """Return light^(1 / 2.4), of light above the straight part of sRGB."""
    return tl.exp2(tl.log2(tl.maximum(light, SRGB_KNEE)) * SRGB_POWER)


@triton.jit
def encode(light):
    """Return the sRGB code of light; the straight part goes on below 0."""
    bent = SRGB_GAIN * root(light) - SRGB_OFFSET
    return tl.where(light > SRGB_KNEE, bent, light * SRGB_LINEAR_GAIN)


@triton.jit
def encode_slope(light):
    """Return the derivative of `encode`."""
    bent = SRGB_GAIN * SRGB_POWER * root(light) / tl.maximum(light, SRGB_KNEE)
    return tl.where(light > SRGB_KNEE, bent, SRGB_LINEAR_GAIN)


@triton.jit
def clip(x):
    """Return x in [0, 1]."""
    return tl.minimum(tl.maximum(x, 0.0), 1.0)


@triton.jit
def is_unclipped(x):
    """Return whether x lies in [0, 1], where a clip has slope 1."""
    return (x >= 0.0) & (x <= 1.0)


@triton.jit
def look_of(looks, image):
    """Return an image's colour matrix, row by row, shoulder, contrast and brightness, as laid out
    by `develop_arrays`."""
    at = looks + image * 12
    matrix = (
        (tl.load(at), tl.load(at + 1), tl.load(at + 2)),
        (tl.load(at + 3), tl.load(at + 4), tl.load(at + 5)),
        (tl.load(at + 6), tl.load(at + 7), tl.load(at + 8)),
    )
    return matrix, tl.load(at + 9), tl.load(at + 10), tl.load(at + 11)


@triton.jit
def mix(red, green, blue, matrix):
    """Return colours times a matrix."""
    return (
        matrix[0][0] * red + matrix[0][1] * green + matrix[0][2] * blue,
        matrix[1][0] * red + matrix[1][1] * green + matrix[1][2] * blue,
        matrix[2][0] * red + matrix[2][1] * green + matrix[2][2] * blue,
    )


@triton.jit
def mix_back(red, green, blue, matrix):
    """Return a gradient in colours times the transpose of a matrix."""
    return (
        matrix[0][0] * red + matrix[1][0] * green + matrix[2][0] * blue,
        matrix[0][1] * red + matrix[1][1] * green + matrix[2][1] * blue,
        matrix[0][2] * red + matrix[1][2] * green + matrix[2][2] * blue,
    )


@triton.jit
def code(light, shoulder, contrast, brighten, CODED: tl.constexpr, TONED: tl.constexpr):
    """Return the code of one colour's light, in [0, 1]."""
    x = light
    if CODED:
        x = encode(light)
    if TONED:
        x = clip(x)
        x *= (1 + shoulder) / (1 + shoulder * x)
        x += contrast * (2 * x - 1) * x * (1 - x)
    return clip(x + brighten)


@triton.jit
def code_slope(light, shoulder, contrast, brighten, CODED: tl.constexpr, TONED: tl.constexpr):
    """Return the derivative of `code` by light. A clip's slope is 1 at its bounds, 0 beyond."""
    x = light
    slope = tl.full(light.shape, 1.0, tl.float32)
    if CODED:
        x = encode(light)
        slope = encode_slope(light)
    if TONED:
        slope = tl.where(is_unclipped(x), slope, 0.0)
        x = clip(x)
        inverse = 1 / (1 + shoulder * x)
        slope *= (1 + shoulder) * inverse * inverse
        x *= (1 + shoulder) * inverse
        slope *= 1 + contrast * (6 * x * (1 - x) - 1)
        x += contrast * (2 * x - 1) * x * (1 - x)
    return tl.where(is_unclipped(x + brighten), slope, 0.0)


@triton.jit
def codes(red, green, blue, look, CODED: tl.constexpr, TONED: tl.constexpr):
    """Return the codes of a pixel's colours, as the sensor has them."""
    red, green, blue = mix(red, green, blue, look[0])
    return (
        code(red, look[1], look[2], look[3], CODED, TONED),
        code(green, look[1], look[2], look[3], CODED, TONED),
        code(blue, look[1], look[2], look[3], CODED, TONED),
    )


@triton.jit
def codes_back(grad, red, green, blue, look, CODED: tl.constexpr, TONED: tl.constexpr):
    """Return the gradient in a pixel's colours, as the sensor has them, from that in its codes."""
    red, green, blue = mix(red, green, blue, look[0])
    return mix_back(
        grad[0] * code_slope(red, look[1], look[2], look[3], CODED, TONED),
        grad[1] * code_slope(green, look[1], look[2], look[3], CODED, TONED),
        grad[2] * code_slope(blue, look[1], look[2], look[3], CODED, TONED),
        look[0],
    )
