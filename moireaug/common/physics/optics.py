"""The modulation transfer of a sensor pixel's aperture, and of what blurs its view.

`exp`, `sinc`, sin(pi x) / (pi x), and `cos_pi`, cos(pi x), are operations that each library brings.
"""

from numpy import exp, pi, sinc

from moireaug.common.physics.operations import cos_pi

TWO_PI_SQUARED = 2 * pi**2


def transfer(fu, fv, optics):
    """Return the transfer at a frequency in cycles per sensor pixel along u and v: of a square
    aperture, a Gaussian spread, another along the hand's motion, and a low-pass filter that doubles
    the picture along both axes.

    optics: fill, blur, olpf, motion_x and motion_y, in sensor pixels.
    """
    fill, blur, olpf, motion_x, motion_y = optics
    moved = fu * motion_x + fv * motion_y
    variance = blur * blur * (fu * fu + fv * fv) + moved * moved
    doubled = cos_pi(olpf * fu) * cos_pi(olpf * fv)
    return sinc(fill * fu) * sinc(fill * fv) * exp(variance * -TWO_PI_SQUARED) * doubled
