"""What the sensor makes of the light on a row of its pixels."""

from __future__ import annotations

import math

import numpy as np

from moireaug.camera.effects.sensor import DARK_LEVEL
from moireaug.common.physics.clipping import MIN_VARIANCE
from moireaug.engine.cpu.compiling import copy, fill, jit_in_place
from moireaug.engine.cpu.normal import integral, normal, normal_row
from moireaug.engine.cpu.physics import sensor

UNCLIPPED_SIGMAS = 5.0  # a mean is clipped by noise only if it is this close to 0 or 1
DARK32 = np.float32(DARK_LEVEL)
ZERO, ONE, TWO = np.float32(0), np.float32(1), np.float32(2)


@jit_in_place
def reflect(line, u, v, white, camera):
    """Add what the glass reflects to a row; u and v (w,) are photo coordinates about the centre,
    white is what the row reads of a white screen on average."""
    if camera.glare == 0:
        return
    for i in range(len(line)):
        glare = camera.glare + camera.glare_u * u[i] + camera.glare_v * v[i]
        line[i] += np.float32(white * glare)


@jit_in_place
def attenuate(line, u, v, camera):
    """Multiply a row by gain and vignetting; u and v (w,) are photo coordinates about the
    centre."""
    gain = np.float32(camera.gain)
    if camera.falloff == 0:
        for i in range(len(line)):
            line[i] *= gain
        return
    for i in range(len(line)):
        falloff, r2 = camera.falloff * camera.radius_scale, u[i] * u[i] + v[i] * v[i]
        line[i] *= np.float32(sensor.attenuation(gain, falloff, r2))


@jit_in_place
def _scale_and_add(line, noise, read_noise, photons):
    """Add standard normal noise to a row, times its standard deviation; read_noise, photons:
    float32, see `records.Readout`."""
    if photons == 0:
        for i in range(len(noise)):
            line[i] += noise[i] * read_noise
        return
    for i in range(len(noise)):
        variance = sensor.noise_variance(line[i], read_noise, photons, DARK32)
        line[i] += noise[i] * np.float32(math.sqrt(variance))


@jit_in_place
def _fill_noise_slope(slope, line, noise, read_noise, photons):
    """Fill slope with the derivative of what `_scale_and_add` makes of a row."""
    fill(slope, ONE)
    if photons == 0:
        return
    for i in range(len(slope)):
        if line[i] > DARK32:
            variance = sensor.noise_variance(line[i], read_noise, photons, DARK32)
            sigma = np.float32(math.sqrt(variance))
            slope[i] += noise[i] * photons * photons / (TWO * sigma)


@jit_in_place
def _mean_excess(mean, variance):
    """Return the mean of max(x, 0) of normally distributed x."""
    if variance <= MIN_VARIANCE or mean * mean > UNCLIPPED_SIGMAS * UNCLIPPED_SIGMAS * variance:
        return max(mean, 0.0)
    return integral(mean, math.sqrt(variance))


@jit_in_place
def _greatest_excess(mean, noise, pattern):
    """Return an upper limit of the mean of max(x - 1, 0): that of light of two levels, one 0."""
    return mean - 1 / (1 + pattern) + math.sqrt(noise / (2 * math.pi))


@jit_in_place
def _excess_slopes(mean, variance):
    """Return the derivatives of `_mean_excess`."""
    if variance <= MIN_VARIANCE or mean * mean > UNCLIPPED_SIGMAS * UNCLIPPED_SIGMAS * variance:
        return (1.0 if mean > 0 else 0.0), 0.0
    sigma = math.sqrt(variance)
    below, density = normal(mean / sigma)
    return below, density / (2 * sigma)


@jit_in_place
def _clip_slope(value, read_variance, photons, pattern):
    """Return the derivative of what `clip_mean` makes of a value, float64."""
    noise = read_variance + photons * max(value, DARK_LEVEL)
    more_noise = photons if value > DARK_LEVEL else 0.0
    variance = noise + value * value * pattern
    by_mean, by_variance = _excess_slopes(value - 1, variance)
    above = by_mean + by_variance * (more_noise + 2 * value * pattern)
    if value * (1 + pattern) > 2:
        most = _greatest_excess(value, noise, pattern)
        if most < _mean_excess(value - 1, variance):
            root = math.sqrt(2 * math.pi * max(noise, MIN_VARIANCE))
            above = 1 + more_noise / (2 * root)
    by_mean, by_variance = _excess_slopes(-value, noise)
    return 1 - by_mean + by_variance * more_noise - above


@jit_in_place
def clip_mean(out, light, slope, read_variance, photons, pattern):
    """Fill a row of binned readings (w,) from its light with the mean of sensor pixels clipped to
    [0, 1], as `clipping.expected_clip` gives it, with short cuts and tables.

    Args:
        slope: as `add_noise` filled it, multiplied by that of the clip.
        read_variance, photons: float32, variance of the noise that was averaged away: in the dark,
            and what a reading of 1 adds.
        pattern: float32, that of the panel's pattern as a share of the squared reading.
    """
    for i in range(len(slope)):
        slope[i] *= np.float32(
            _clip_slope(float(light[i]), float(read_variance), float(photons), float(pattern))
        )
    for i in range(len(out)):
        value = light[i]
        noise = read_variance + photons * max(value, DARK32)
        above = _mean_excess(float(value) - 1.0, noise + value * value * pattern)
        if value * (1 + pattern) > 2:  # else the limit is never the smaller
            above = min(above, _greatest_excess(float(value), noise, pattern))
        out[i] = np.float32(value + _mean_excess(-float(value), noise) - above)


@jit_in_place
def add_noise(light, slope, start, readout, noise, bits):
    """Add noise to the light on a row of pixels (w,), the first of which is number `start` of the
    image's raw.

    Args:
        slope: (w,) float32, filled with the derivative of the result in the light; or (0,).
        readout: see `records.Readout`.
        noise, bits: (w,) workspaces, float32 and int32.
    """
    if readout.noisy:
        normal_row(noise, bits, start, readout.keys[0], readout.keys[1])
        _fill_noise_slope(slope, light, noise, readout.dark_noise, readout.photon_noise)
        _scale_and_add(light, noise, readout.dark_noise, readout.photon_noise)
    else:
        fill(slope, ONE)


@jit_in_place
def read(out, light, slope, start, readout, noise, bits):
    """Fill a row of readings (w,) from its light: noisy, and clipped; arguments as in
    `add_noise`."""
    add_noise(light, slope, start, readout, noise, bits)
    if readout.clips:
        for i in range(len(slope)):
            slope[i] = slope[i] if ZERO <= light[i] <= ONE else ZERO
        for i in range(len(out)):
            out[i] = min(max(light[i], ZERO), ONE)
    else:
        copy(out, light)


@jit_in_place
def read_back(light, grad, slope):
    """Fill light (w,) with the gradient in a row's light, from that in its readings and what `read`
    filled slope with."""
    for i in range(len(light)):
        light[i] = grad[i] * slope[i]
