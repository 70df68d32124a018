"""The hash behind the sensor's noise; see `moireaug.camera.effects.random_numbers`."""

from moireaug.common.physics.operations import shifted, wrapped

FIRST_FACTOR, SECOND_FACTOR = 0x7FEB352D, 0x846CA68B  # the multipliers of Wellons's lowbias32


def mix(x):
    """Scramble a number of 32 bits."""
    x = wrapped(x ^ shifted(x, 16))
    x = wrapped(x * FIRST_FACTOR)
    x = wrapped(x ^ shifted(x, 15))
    x = wrapped(x * SECOND_FACTOR)
    return wrapped(x ^ shifted(x, 16))
