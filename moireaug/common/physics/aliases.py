"""What a binned reading leaves of the aliases of a harmonic; see
`moireaug.camera.exposure.alias_transfer`.

`sinc`, sin(pi x) / (pi x), is an operation that each library brings.
"""

from numpy import pi, sinc

from moireaug.common.physics.operations import maximum, minimum, where


def mean_over_sides(wave, first, second):
    """Return what the mean over a bin leaves of a wave, by its cycles along the two sides."""
    return wave * sinc(first) * sinc(second)


def interpolation_transfer(even, is_odd):
    """Return what interpolation between pixels two apart leaves of an alias along an axis, from
    what it leaves of even ones, cos(pi f)^2."""
    return where(is_odd, 1 - even, even)


def plane_transfers(along_u, along_v, is_odd_u, is_odd_v):
    """Return what interpolation leaves of an alias in the planes of red and blue, and of green, a
    quincunx; along_u, along_v: from `interpolation_transfer`."""
    quincunx = where(is_odd_u == is_odd_v, (along_u + along_v) / 2, 0.0)
    return along_u * along_v, quincunx


def least_magnitude(low, high):
    """Return the least magnitude in a range."""
    return maximum(maximum(low, -high), 0.0)


def max_hold_transfer(low, high, m):
    """Return the most that holding values over pixels leaves of an alias m of frequencies from
    `low` to `high`."""
    nearest = least_magnitude(low - m / 2, high - m / 2)
    return maximum(1 - nearest * nearest, 0.0)


def max_mean_transfer(cycles, side_u, side_v, m_u, m_v):
    """Return the most that the mean along a side of bins leaves of an alias.

    cycles, side_u, side_v: the ranges of a harmonic's cycles along the side and of the side's
        coordinates, low and high.
    """
    u = m_u / 2 * side_u[0], m_u / 2 * side_u[1]
    v = m_v / 2 * side_v[0], m_v / 2 * side_v[1]
    low = cycles[0] - maximum(u[0], u[1]) - maximum(v[0], v[1])
    high = cycles[1] - minimum(u[0], u[1]) - minimum(v[0], v[1])
    return 1 / maximum(pi * least_magnitude(low, high), 1.0)
