"""The tone curve of codes, and its slope: a shoulder, which rolls off highlights, and then
contrast."""

from moireaug.common.physics.operations import ONE, SIX, TWO


def shoulder_curve(x, shoulder):
    """Return a code whose highlights are rolled off."""
    return x * ((ONE + shoulder) / (ONE + shoulder * x))


def contrast_curve(x, contrast):
    """Return a code with more contrast."""
    return x + contrast * (TWO * x - ONE) * x * (ONE - x)


def shoulder_and_slope(x, shoulder):
    """Return `shoulder_curve`, and its derivative."""
    inverse = ONE / (ONE + shoulder * x)
    factor = (ONE + shoulder) * inverse
    return x * factor, factor * inverse


def contrast_slope(x, contrast):
    """Return the derivative of `contrast_curve`."""
    return ONE + contrast * (SIX * x * (ONE - x) - ONE)
