"""sRGB codes and their light, and the slope of either."""

from moireaug.common.physics.operations import maximum, power, where

SLOPE_AT_BLACK = 12.92  # codes per light
CODE_KNEE, LIGHT_KNEE = 0.04045, 0.0031308  # where the curve leaves its straight part
GAIN, OFFSET, EXPONENT = 1.055, 0.055, 2.4


def light_of_code(code):
    """Return the light of a code: straight at and below black, and continued above white."""
    light = power(maximum(code + OFFSET, 0.0) / GAIN, EXPONENT)
    return where(code > CODE_KNEE, light, code / SLOPE_AT_BLACK)


def bent_slope(code):
    """Return the derivative of `light_of_code` above the knee."""
    return EXPONENT / GAIN * power(maximum(code + OFFSET, 0.0) / GAIN, EXPONENT - 1)


def light_slope(code):
    """Return the derivative of `light_of_code`."""
    return where(code > CODE_KNEE, bent_slope(code), 1 / SLOPE_AT_BLACK)


def _curve(light):
    return GAIN * power(maximum(light, LIGHT_KNEE), 1 / EXPONENT)


def code_of_light(light):
    """Return the code of light, the inverse of `light_of_code`."""
    return where(light > LIGHT_KNEE, _curve(light) - OFFSET, SLOPE_AT_BLACK * light)


def code_slope(light):
    """Return the derivative of `code_of_light`."""
    slope = _curve(light) / (EXPONENT * maximum(light, LIGHT_KNEE))
    return where(light > LIGHT_KNEE, slope, SLOPE_AT_BLACK)
