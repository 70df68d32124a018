"""The view of a sensor pixel along one axis of the panel, a box and a Gaussian; see
`moireaug.camera.exposure.footprint`.

`by_u`, `by_v` are cells of the panel, or its pixels, per sensor pixel along u and v.
"""

from moireaug.common.physics.operations import maximum, minimum

TAIL_SIGMAS = 1.0  # standard deviations of the spread that taps must reach
MIN_BLUR_VARIANCE = 1e-12  # squared cells: a Gaussian of 0 has no density


def motion_sigma(by_u, by_v, motion_x, motion_y):
    """Return the standard deviation of motion blur, with a sign."""
    return by_u * motion_x + by_v * motion_y


def lens_variance(by_u, by_v, blur, olpf):
    """Return the variance that lens and low-pass filter add."""
    return (by_u * by_u + by_v * by_v) * (blur * blur + olpf * olpf / 4)


def side_variance(short):
    """Return the variance of the shorter side of an aperture's shadow, whose longer is the box."""
    return short * short / 12


def reach(box, sigma):
    """Return how far to each side a view sees."""
    return box / 2 + TAIL_SIGMAS * sigma


def narrowing(box, sigma, width, end):
    """Return the factor that narrows a view so that it sees nothing but subpixels of a width, as
    far as the `end` of the cells around it; in cells."""
    room = maximum(end - width / 2, MIN_BLUR_VARIANCE)
    return minimum(room / reach(box, sigma), 1.0)
