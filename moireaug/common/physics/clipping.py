"""The mean of sensor pixels that are clipped to [0, 1], by their mean and their variances; see
`moireaug.camera.effects.sensor`.

`exp` and `normal_cdf`, the normal distribution function, are operations that each library brings.
"""

from numpy import exp, pi

from moireaug.common.physics.operations import maximum, minimum, normal_cdf, sqrt, where

MIN_VARIANCE = 1e-10  # of readings that count as different
PEAK = (2 * pi) ** -0.5  # of the standard normal density


def expected_clip(light, noise, pattern):
    """Return the mean of readings clipped to [0, 1], by their mean and the variances of noise and
    of the panel's pattern, both taken as normally distributed. A pattern is light, and never below
    0: noise alone is clipped there."""
    above = minimum(mean_excess(light - 1, noise + pattern), greatest_excess(light, noise, pattern))
    return light + mean_excess(-light, noise) - above


def mean_excess(mean, variance):
    """Return the mean of max(x, 0) of normally distributed x."""
    some = variance > MIN_VARIANCE
    sigma = sqrt(where(some, variance, 1.0))
    z = mean / sigma
    excess = mean * normal_cdf(z) + sigma * exp(-z * z / 2) * PEAK
    return where(some, excess, where(mean > 0, mean, 0.0))


def excess_slopes(mean, variance):
    """Return the derivatives of `mean_excess` in mean and variance."""
    some = variance > MIN_VARIANCE
    sigma = sqrt(where(some, variance, 1.0))
    z = mean / sigma
    by_mean = where(some, normal_cdf(z), where(mean > 0, 1.0, 0.0))
    return by_mean, where(some, exp(-z * z / 2) * PEAK / (2 * sigma), 0.0)


def greatest_excess(light, noise, pattern):
    """Return the most that the mean of max(x - 1, 0) can be of light x, which is nowhere below 0,
    with noise; light, pattern: its mean and variance. No light of that mean and variance, however
    sparse, has a smaller mean when clipped than one of two levels, one of which is 0 (Scarf,
    1958)."""
    light = maximum(light, MIN_VARIANCE)
    clipped = minimum(light / 2, light * light / (light * light + pattern))
    some = noise > MIN_VARIANCE  # the root has no slope at 0
    sigma = where(some, sqrt(where(some, noise, 1.0)), 0.0)
    return light - clipped + sigma * PEAK


def clip_slope(light, noise, pattern, noise_slope):
    """Return the derivative of `expected_clip` in the light, of noise that grows with it by
    `noise_slope`, and of a pattern that grows with its square."""
    pattern_slope = 2 * pattern / maximum(light, MIN_VARIANCE)
    by_mean, by_variance = excess_slopes(light - 1, noise + pattern)
    above = by_mean + by_variance * (noise_slope + pattern_slope)
    some = noise > MIN_VARIANCE
    at_limit = 1 + where(some, PEAK * noise_slope / (2 * sqrt(where(some, noise, 1.0))), 0.0)
    excess = mean_excess(light - 1, noise + pattern)
    above = where(greatest_excess(light, noise, pattern) < excess, at_limit, above)
    by_mean, by_variance = excess_slopes(-light, noise)
    return 1 - by_mean + by_variance * noise_slope - above
