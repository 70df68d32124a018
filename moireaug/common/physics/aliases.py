"""What a binned reading leaves of the aliases of a harmonic; see
`moireaug.camera.exposure.alias_transfer`.

`sinc`, sin(pi x) / (pi x), is an operation that each library brings.
"""

from numpy import sinc

from moireaug.common.physics.operations import where


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
