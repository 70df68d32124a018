"""From a pixel's light to codes: white balance, colour matrix, sRGB, tone curve and brightness; and
the gradient on the way back."""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl

from moireaug.engine.gpu.physics import encoding
from moireaug.engine.gpu.physics import tone as curve


class Tone(NamedTuple):
    """An image's colours: what codes are made with besides its light; see
    `development_records.Codes`.

    Args:
        matrix: three rows of three.
    """

    matrix: Any
    shoulder: Any
    contrast: Any
    brighten: Any


@triton.jit
def clip(x):
    """Return x in [0, 1]."""
    return tl.minimum(tl.maximum(x, 0.0), 1.0)


@triton.jit
def clip_back(grad, x):
    """Return the gradient in x, from that in its clip: the same at the bounds, too, 0 beyond."""
    return tl.where((x >= 0.0) & (x <= 1.0), grad, 0.0)


@triton.jit
def tone_of(tones, image):
    """Return an image's Tone, as laid out by `develop_arrays`."""
    at = tones + image * 12
    matrix = (
        (tl.load(at), tl.load(at + 1), tl.load(at + 2)),
        (tl.load(at + 3), tl.load(at + 4), tl.load(at + 5)),
        (tl.load(at + 6), tl.load(at + 7), tl.load(at + 8)),
    )
    return Tone(matrix, tl.load(at + 9), tl.load(at + 10), tl.load(at + 11))


@triton.jit
def mix(colours, matrix):
    """Return colours times a matrix."""
    red, green, blue = colours
    return [row[0] * red + row[1] * green + row[2] * blue for row in matrix]


@triton.jit
def code(light, tone, variant: tl.constexpr):
    """Return the code of one colour's light, in [0, 1], and its derivative."""
    x, slope = light, tl.full(light.shape, 1.0, tl.float32)
    if variant.coded:
        x, slope = encoding.code_of_light(light), encoding.code_slope(light)
    if variant.toned:
        slope = clip_back(slope, x)
        x = clip(x)
        x, steepness = curve.shoulder_and_slope(x, tone.shoulder)
        slope *= steepness * curve.contrast_slope(x, tone.contrast)
        x = curve.contrast_curve(x, tone.contrast)
    x += tone.brighten
    return clip(x), clip_back(slope, x)


@triton.jit
def codes(colours, tone, variant: tl.constexpr):
    """Return the codes of a pixel's colours, as the sensor has them; variant: see
    `develop_arrays.CodesVariant`."""
    return [code(light, tone, variant)[0] for light in mix(colours, tone.matrix)]


@triton.jit
def codes_back(grad, colours, tone, variant: tl.constexpr):
    """Return the gradient in a pixel's colours, as the sensor has them, from that in its codes."""
    slopes = [code(light, tone, variant)[1] for light in mix(colours, tone.matrix)]
    red, green, blue = grad[0] * slopes[0], grad[1] * slopes[1], grad[2] * slopes[2]
    matrix = tone.matrix
    return (
        matrix[0][0] * red + matrix[1][0] * green + matrix[2][0] * blue,
        matrix[0][1] * red + matrix[1][1] * green + matrix[2][1] * blue,
        matrix[0][2] * red + matrix[1][2] * green + matrix[2][2] * blue,
    )
