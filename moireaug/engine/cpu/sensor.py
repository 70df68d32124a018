"""What the sensor makes of the light on a row of its pixels."""

from __future__ import annotations

import math

import numpy as np

from moireaug.effects.sensor import DARK_LEVEL, LEAST_VARIANCE
from moireaug.engine.cpu.compiling import copy, inner
from moireaug.engine.cpu.random_numbers import normal_row
from moireaug.engine.cpu.tables import integral

DARK32 = np.float32(DARK_LEVEL)
UNCLIPPED_SIGMAS = 5.0  # noise does not matter to a mean so far from a bound
ZERO, ONE = np.float32(0), np.float32(1)


@inner
def reflect(line, u, v, white, camera):
    """Add what the glass reflects to a row; u and v (w,) are photo coordinates about the centre,
    white is what the row reads of a white screen on average."""
    if camera.glare == 0:
        return
    for i in range(len(line)):
        glare = camera.glare + camera.glare_u * u[i] + camera.glare_v * v[i]
        line[i] += np.float32(white * glare)


@inner
def attenuate(line, u, v, camera):
    """Multiply a row by gain and vignetting; u and v (w,) are photo coordinates about the
    centre."""
    gain = np.float32(camera.gain)
    if camera.falloff == 0:
        for i in range(len(line)):
            line[i] *= gain
        return
    for i in range(len(line)):
        dimmed = 1 + camera.falloff * camera.bend * (u[i] * u[i] + v[i] * v[i])
        line[i] *= np.float32(gain / (dimmed * dimmed))


@inner
def _scale_and_add(line, noise, dark, photons):
    """Add standard normal noise to a row, times its standard deviation; dark, photons: float32, see
    `exposure_records.Readout`."""
    if photons == 0:
        for i in range(len(noise)):
            line[i] += noise[i] * dark
        return
    for i in range(len(noise)):
        variance = dark * dark + photons * photons * max(line[i], DARK32)
        line[i] += noise[i] * np.float32(math.sqrt(variance))


@inner
def _mean_excess(mean, variance):
    """Return the mean of max(x, 0) of normally distributed x."""
    if variance <= LEAST_VARIANCE or mean * mean > UNCLIPPED_SIGMAS * UNCLIPPED_SIGMAS * variance:
        return max(mean, 0.0)
    return integral(mean, math.sqrt(variance))


@inner
def _greatest_excess(mean, noise, pattern):
    """Return a bound on the mean of max(x - 1, 0) of light of two levels, one of which is 0."""
    return mean - 1 / (1 + pattern) + math.sqrt(noise / (2 * math.pi))


@inner
def clip_mean(out, light, dark, photons, pattern):
    """Fill a row of binned readings (w,) from its light with the mean of sensor pixels clipped to
    [0, 1], as `effects.sensor.expected_clip` does.

    Args:
        dark, photons: float32, variance of the noise that was averaged away: in the dark, and what
            a reading of 1 adds.
        pattern: float32, that of the panel's pattern as a share of the squared reading.
    """
    for i in range(len(out)):
        value = light[i]
        noise = dark + photons * max(value, DARK32)
        above = _mean_excess(float(value) - 1.0, noise + value * value * pattern)
        if value * (1 + pattern) > 2:  # else the bound is never the smaller
            above = min(above, _greatest_excess(float(value), noise, pattern))
        out[i] = np.float32(value + _mean_excess(-float(value), noise) - above)


@inner
def add_noise(light, start, readout, noise, bits):
    """Add noise to the light on a row of pixels (w,), the first of which is number `start` of the
    image's raw.

    Args:
        readout: see `exposure_records.Readout`.
        noise, bits: (w,) workspaces, float32 and int32.
    """
    if readout.noisy:
        normal_row(noise, bits, start, readout.keys[0], readout.keys[1])
        _scale_and_add(light, noise, readout.dark_noise, readout.photon_noise)


@inner
def read(out, light, start, readout, noise, bits):
    """Fill a row of readings (w,) from its light: noisy, and clipped; arguments as in
    `add_noise`."""
    add_noise(light, start, readout, noise, bits)
    if readout.clips:
        for i in range(len(out)):
            out[i] = min(max(light[i], ZERO), ONE)
    else:
        copy(out, light)
