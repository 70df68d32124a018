"""What the sensor makes of the light on a row of its pixels."""

from __future__ import annotations

import math

import numpy as np

from moireaug.effects.sensor import DARK, LEAST_VARIANCE
from moireaug.engine.compiling import inner
from moireaug.engine.random_numbers import normal_row
from moireaug.engine.tables import integral

DARK32 = np.float32(DARK)
FARTHEST = 5.0  # standard deviations from a bound at which nothing is clipped
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
def _add_noise(line, numbers, read, shot):
    if shot == 0:
        for i in range(len(numbers)):
            line[i] += numbers[i] * read
        return
    for i in range(len(numbers)):
        variance = read * read + shot * shot * max(line[i], DARK32)
        line[i] += numbers[i] * np.float32(math.sqrt(variance))


@inner
def _mean_excess(mean, variance):
    """Return the mean of max(x, 0) of normally distributed x."""
    if variance <= LEAST_VARIANCE or mean * mean > FARTHEST * FARTHEST * variance:
        return max(mean, 0.0)
    return integral(mean, math.sqrt(variance))


@inner
def clip_mean(line, read, shot, pattern):
    """Replace a row of readings by the mean of their sensor pixels, clipped to [0, 1], as
    `effects.sensor.expected_clip` does.

    read, shot: float32, variance of the noise that was averaged away, in the dark and what a
    reading of 1 adds. pattern: that of the panel's pattern, as a share of the squared reading.
    """
    for i in range(len(line)):
        value = line[i]
        noise = read + shot * max(value, DARK32)
        above = _mean_excess(float(value) - 1.0, noise + value * value * pattern)
        line[i] = np.float32(value + _mean_excess(-float(value), noise) - above)


@inner
def read(out, light, camera, start, noise, keys, numbers, bits, clips):
    """Fill a row of readings (w,) from its light, whose first pixel is number `start` of the
    image's raw.

    keys: of the noise, from `random_numbers.keys`. numbers, bits: (w,) workspaces, float32 and
    int32. The rest as in `expose.expose`.
    """
    if noise:
        normal_row(numbers, bits, start, keys[0], keys[1])
        _add_noise(light, numbers, np.float32(camera.read), np.float32(camera.shot))
    if clips:
        for i in range(len(out)):
            out[i] = min(max(light[i], ZERO), ONE)
    else:
        for i in range(len(out)):
            out[i] = light[i]
