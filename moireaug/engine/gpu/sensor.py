"""What glass, lens and sensor make of the light on a pixel, float32.

`camera` points to one image's Camera, float64; u, v is a photo point about the photo's centre.
"""

from __future__ import annotations

import math

import triton
import triton.language as tl

from moireaug.camera.effects import binned_statistics, sensor
from moireaug.engine.gpu.arrays import camera_field
from moireaug.engine.gpu.optics import MIN_EXPONENT
from moireaug.engine.gpu.physics import sensor as physics
from moireaug.engine.gpu.random_numbers import normal
from moireaug.engine.gpu.view import RADIUS_SCALE, load32

GAIN, FALLOFF = camera_field("gain"), camera_field("falloff")
GLARE, GLARE_U, GLARE_V = camera_field("glare"), camera_field("glare_u"), camera_field("glare_v")
DARK_NOISE, PHOTON_NOISE = camera_field("dark_noise"), camera_field("photon_noise")

DARK_LEVEL = tl.constexpr(sensor.DARK_LEVEL)
MIN_VARIANCE = tl.constexpr(binned_statistics.MIN_VARIANCE)
ROOT_HALF = tl.constexpr(0.5**0.5)
PEAK = tl.constexpr((2 * math.pi) ** -0.5)  # of the standard normal density


@triton.jit
def flicker(light_of_rows, row, last):
    """Return the light at a row relative to the panel's mean, interpolated linearly.

    light_of_rows: (last + 2,) float32, of the image. row: place in it, clipped to [0, last].
    """
    row = tl.minimum(tl.maximum(row, 0.0), last)
    before = row.to(tl.int32)
    low, high = tl.load(light_of_rows + before), tl.load(light_of_rows + before + 1)
    return low + (row - before) * (high - low)


@triton.jit
def reflected(u, v, camera):
    """Return what the glass reflects, as a share of what a plane reads of a white screen."""
    return load32(camera, GLARE) + load32(camera, GLARE_U) * u + load32(camera, GLARE_V) * v


@triton.jit
def attenuation(u, v, camera):
    """Return the factor of gain and vignetting."""
    falloff = load32(camera, FALLOFF) * load32(camera, RADIUS_SCALE)
    return physics.attenuation(load32(camera, GAIN), falloff, u * u + v * v)


@triton.jit
def noise_of(light, index, keys, camera, quantiles):
    """Return the noise of a reading, and its derivative in the light; for quantiles, see
    `random_numbers.normal`."""
    read_noise, photons = load32(camera, DARK_NOISE), load32(camera, PHOTON_NOISE)
    variance = physics.noise_variance(light, read_noise, photons, DARK_LEVEL)
    some = variance > 0.0
    sigma = tl.where(some, tl.sqrt(tl.where(some, variance, 1.0)), 0.0)
    number = normal(index, keys, quantiles)
    grows = some & (light > DARK_LEVEL)
    slope = tl.where(grows, 0.5 * photons * photons / tl.where(some, sigma, 1.0), 0.0)
    return number * sigma, number * slope


@triton.jit
def reading(light, pulse, u, v, white, camera, noise, NOISY: tl.constexpr):
    """Return readings before they are clipped, and their derivative in the panel's light.

    Args:
        light: of the panel, without flicker, through a plane's filter. pulse: of the flicker.
        white: what the plane reads of a white screen. noise: indices, keys and quantiles, see
            `random_numbers.normal`. NOISY: whether there is any.
    """
    u, v = u.to(tl.float32), v.to(tl.float32)
    factor = attenuation(u, v, camera)
    value, slope = factor * (light * pulse + white * reflected(u, v, camera)), factor * pulse
    if NOISY:
        index, keys, quantiles = noise
        added, by_light = noise_of(value, index, keys, camera, quantiles)
        value, slope = value + added, slope * (1.0 + by_light)
    return value, slope


@triton.jit
def mean_excess(mean, variance):
    """Return the mean of max(x, 0) of normally distributed x, and its derivatives in mean and
    variance."""
    some = variance > MIN_VARIANCE
    sigma = tl.sqrt(tl.where(some, variance, 1.0))
    z = mean / sigma
    share = 0.5 + 0.5 * tl.erf(z * ROOT_HALF)
    density = PEAK * tl.exp(tl.maximum(-0.5 * z * z, MIN_EXPONENT))
    excess = tl.where(some, mean * share + sigma * density, tl.maximum(mean, 0.0))
    by_mean = tl.where(some, share, tl.where(mean > 0.0, 1.0, 0.0))
    return excess, by_mean, tl.where(some, 0.5 * density / sigma, 0.0)


@triton.jit
def clipped_mean(light, read_variance, photons, pattern):
    """Return the mean of sensor pixels clipped to [0, 1], as `binned_statistics.expected_clip`,
    from their mean light, and its derivative in that.

    Args:
        read_variance, photons: variance of the noise that was averaged away, in the dark, and what
            a reading of 1 adds. pattern: that of the panel's pattern as a share of the squared
            reading.
    """
    noise = read_variance + photons * tl.maximum(light, DARK_LEVEL)
    noise_slope = tl.where(light > DARK_LEVEL, photons, 0.0)
    below, below_by_mean, below_by_noise = mean_excess(-light, noise)
    spread = tl.maximum(light, 0.0) * pattern
    above, above_slope, above_by_variance = mean_excess(light - 1.0, noise + light * spread)
    above_slope += above_by_variance * (noise_slope + 2.0 * spread)
    # no light of two levels, one of which is 0, has more above 1
    some = noise > MIN_VARIANCE
    sigma = tl.sqrt(tl.where(some, noise, 1.0))
    bound = light - 1.0 / (1.0 + pattern) + tl.where(some, PEAK * sigma, 0.0)
    bounded = (light * (1.0 + pattern) > 2.0) & (bound < above)  # else it is never the smaller
    bound_slope = 1.0 + tl.where(some, 0.5 * PEAK * noise_slope / sigma, 0.0)
    clipped = light + below - tl.where(bounded, bound, above)
    slope = 1.0 - below_by_mean + below_by_noise * noise_slope
    return clipped, slope - tl.where(bounded, bound_slope, above_slope)
