"""What glass, lens and sensor make of the light on a pixel, float32, with the noise of
`moireaug.camera.effects.random_numbers`, bit for bit.

`camera` points to one image's Camera, float64; u, v is a photo point about the photo's centre.
"""

from __future__ import annotations

import functools

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.camera.effects import random_numbers as numbers
from moireaug.camera.effects import sensor
from moireaug.engine.gpu.arrays import camera_field
from moireaug.engine.gpu.optics import bell
from moireaug.engine.gpu.physics import bind_for_triton, random_numbers
from moireaug.engine.gpu.physics import sensor as physics
from moireaug.engine.gpu.view import RADIUS_SCALE, load32

INTERVAL_SHIFT = tl.constexpr(numbers.PLACES_PER_INTERVAL.bit_length() - 1)
INTERVAL_MASK = tl.constexpr(numbers.INTERVALS - 1)
PLACE_MASK = tl.constexpr(numbers.PLACES_PER_INTERVAL - 1)

GAIN, FALLOFF = camera_field("gain"), camera_field("falloff")
GLARE, GLARE_U, GLARE_V = camera_field("glare"), camera_field("glare_u"), camera_field("glare_v")
DARK_NOISE, PHOTON_NOISE = camera_field("dark_noise"), camera_field("photon_noise")

DARK_LEVEL = tl.constexpr(sensor.DARK_LEVEL)
ROOT_HALF = tl.constexpr(0.5**0.5)


@functools.lru_cache(maxsize=8)
def quantiles(device: torch.device) -> Tensor:
    """Return `random_numbers.quantiles` on a device, (2048, 2) float32: low, and step."""
    return torch.stack(numbers.quantiles(), 1).contiguous().to(device)


@triton.jit
def normal(index, keys, quantiles):
    """Return the standard normal numbers of these indices of an image, float32.

    Args:
        index: int32. keys: (2,) int32, of the image. quantiles: (2048, 2) float32, see there.
    """
    first = tl.load(keys).to(tl.uint32, bitcast=True)
    second = tl.load(keys + 1).to(tl.uint32, bitcast=True)
    bits = random_numbers.mix(random_numbers.mix(index.to(tl.uint32) + first) ^ second)
    interval = (bits >> INTERVAL_SHIFT) & INTERVAL_MASK
    place = (bits & PLACE_MASK).to(tl.float32)
    low, step = tl.load(quantiles + 2 * interval), tl.load(quantiles + 2 * interval + 1)
    # a product that is rounded by itself: the compiler would fuse another with the sum
    return low + tl.fma(step, place, 0.0)


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
    `normal`."""
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
            `normal`. NOISY: whether there is any.
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
def normal_cdf(z):
    """Return the normal distribution function."""
    return 0.5 + 0.5 * tl.erf(z * ROOT_HALF)


clipping = bind_for_triton("clipping", exp=bell, normal_cdf=normal_cdf)


@triton.jit
def clipped_mean(light, read_variance, photons, pattern):
    """Return the mean of sensor pixels clipped to [0, 1], from their mean light, and its derivative
    in that.

    Args:
        read_variance, photons: variance of the noise that was averaged away, in the dark, and what
            a reading of 1 adds. pattern: that of the panel's pattern as a share of the squared
            reading.
    """
    noise = read_variance + photons * tl.maximum(light, DARK_LEVEL)
    noise_slope = tl.where(light > DARK_LEVEL, photons, 0.0)
    lost = light * tl.maximum(light, 0.0) * pattern
    mean = clipping.expected_clip(light, noise, lost)
    return mean, clipping.clip_slope(light, noise, lost, noise_slope)
