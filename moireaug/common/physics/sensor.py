"""What a sensor pixel makes of its light."""

from moireaug.common.physics.operations import maximum


def noise_variance(light, read, photons, dark):
    """Return the variance of a reading's noise: of read noise, and of photon noise, which falls no
    further below the light `dark`; read, photons: standard deviations, the latter at full scale."""
    return read * read + photons * photons * maximum(light, dark)


def attenuation(gain, falloff, r2):
    """Return the factor of gain and vignetting at a squared radius; falloff: the squared tangent of
    the ray at radius 1."""
    dimmed = 1 + falloff * r2
    return gain / (dimmed * dimmed)
