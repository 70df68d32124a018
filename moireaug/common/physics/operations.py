"""The operations that formulas are written over, as numpy has them, and constants that a library
may hold in another dtype."""

import math

import numpy as np

where, maximum, minimum, absolute = np.where, np.maximum, np.minimum, np.abs
sqrt, ceil, power = np.sqrt, np.ceil, np.power
ONE, TWO, SIX = 1.0, 2.0, 6.0


def cos_pi(x):
    """Return cos(pi x)."""
    return np.cos(np.pi * x)


def normal_cdf(z):
    """Return the normal distribution function."""
    return 0.5 * np.vectorize(math.erfc)(-z * 0.5**0.5)


def wrapped(x):
    """Return a whole number as one of 32 bits."""
    return np.uint32(x)


def shifted(x, bits):
    """Return a number of 32 bits, shifted right; zeros follow."""
    return x >> np.uint32(bits)
