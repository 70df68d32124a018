"""The sensor after the exposure: gain, noise, saturation, quantisation."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from moireaug.camera.effects import random_numbers  # noqa: F401  # defines torch.ops.moireaug.normal
from moireaug.camera.effects.base import Effect, Verdict, called, format_range, left_out, verdict_of
from moireaug.camera.effects.srgb import in_codes
from moireaug.camera.exposure.extremes import can_saturate
from moireaug.common import tensor_physics
from moireaug.common.numeric import clip, per_image, saturate
from moireaug.scene.fields import bounds, deviation
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import ShotGeometry

DARK_LEVEL = 1e-4  # of full scale, below which photon noise falls no further: dark current
NOISE_SIGMAS = 6  # how far noise reaches, in standard deviations


class Gain(Effect):
    """Amplifies the reading."""

    name = "gain"

    def verdict(self, scene: SceneRecord) -> Verdict:
        gain = scene.sensor.gain
        return verdict_of(deviation(gain, 1), scene, f"raw times {format_range(gain)}", "gain is 1")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        return raw * per_image(shot.sensor.gain, raw)


class Noise(Effect):
    """Photon noise, which grows with the square root of the reading, and read noise."""

    name = "noise"

    def verdict(self, scene: SceneRecord) -> Verdict:
        sensor = scene.sensor
        read, photons = bounds(sensor.read_noise)[1], bounds(sensor.shot_noise)[1]
        why = f"standard deviation {format_range(sensor.read_noise)}"
        if photons:
            why += f", and {format_range(sensor.shot_noise)} times the root of the reading"
        change = NOISE_SIGMAS * (read**2 + photons**2) ** 0.5
        return verdict_of(in_codes(change, scene), scene, why, "read_noise and shot_noise are 0")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        read, photons = shot.sensor.read_noise, shot.sensor.shot_noise
        if shot.scene.is_binned:
            root = pixels_per_value(shot, shot.bin_scale).sqrt()
            read, photons = read / root, photons / root
        return add_noise(raw, read, photons, shot.seed)


class ClipReading(Effect):
    """Clips the reading to [0, 1] before an attacker's noise, so that small noise has an effect.

    Of a binned reading each sensor pixel was clipped: it gets the mean of the clipped pixels, given
    the variance of their noise and of the panel's pattern, as if all of the reading's light, glare
    too, came through the panel's pixels.
    """

    name = "clip_reading"
    is_listed = False

    def verdict(self, scene: SceneRecord) -> Verdict:
        if Saturate().verdict(scene).called or Noise().verdict(scene).called:
            return called("a reading can leave [0, 1], and ends there")
        return left_out("no reading leaves [0, 1]")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        return mean_of_clipped(raw, shot) if shot.scene.is_binned else clip(raw)


def mean_of_clipped(raw: Tensor, shot: ShotRecord, share: Tensor | float = 1.0) -> Tensor:
    """Return a binned reading (B, planes, h, w) as the means of its clipped sensor pixels.

    Args:
        share: of each pixel that shows the panel's pattern, (B, 1, h, w).
    """
    read, photons, pattern = (t.to(raw.dtype) for t in lost_variances(shot))
    pattern = pattern[:, :, None, None]
    if raw.shape[1] == 4:
        pattern = pattern[:, [0, 1, 1, 2]]
    noise = read + photons * raw.clamp(min=DARK_LEVEL)
    return tensor_physics.clipping.expected_clip(raw, noise, raw.square() * pattern * share)


class Saturate(Effect):
    """Saturates the reading at a full well, 1, after an attacker's noise."""

    name = "saturate"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if can_saturate(scene):
            return called("the reading can exceed a full well")
        return left_out("no reading exceeds a full well")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        return saturate(raw)


class Bits(Effect):
    """Rounds the reading to the converter's levels."""

    name = "bits"

    def verdict(self, scene: SceneRecord) -> Verdict:
        bits = scene.sensor.bits
        if bits is None or scene.is_binned:
            return left_out("a mean is not rounded" if bits else "the reading is not rounded")
        step = 1 / (2**bits - 1)
        return verdict_of(in_codes(step / 2, scene), scene, f"{bits} bits", "")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        bits = shot.scene.sensor.bits
        return raw if bits is None else quantise(raw, bits)


def add_noise(raw: Tensor, read: Tensor, photons: Tensor, seeds: Tensor) -> Tensor:
    """Add Gaussian noise of variance `read^2 + photons^2 * raw` to `raw` (B, C, h, w), one stream
    per seed (B,) int64.

    Photon noise is Poisson noise in its Gaussian limit; a full well of N electrons has
    `photons = N^-1/2`. Its variance stops falling at `raw = DARK_LEVEL`. Differentiable in raw,
    read and photons. Replays bit for bit on any device.
    """
    noise = torch.ops.moireaug.normal(raw.shape[1:], seeds).to(raw.dtype)
    read, photons = per_image(read, raw), per_image(photons, raw)
    variance = tensor_physics.sensor.noise_variance(raw, read, photons, DARK_LEVEL)
    some = variance > 0  # the root has no slope at 0
    return raw + noise * torch.where(some, torch.where(some, variance, 1.0).sqrt(), 0.0)


def quantise(raw: Tensor, bits: int) -> Tensor:
    """Round to the `2^bits` levels of a converter whose ends are 0 and 1; the gradient passes
    straight through."""
    levels = 2**bits - 1
    return raw + (torch.round(raw.detach().clamp(0, 1) * levels) / levels - raw.detach())


def pixels_per_value(shot: ShotGeometry, scale: Any) -> Any:
    """Return how many sensor pixels of one colour a value of a binned reading averages, (B,), for
    `shot.bin_scale`; of torch or numpy."""
    if shot.scene.develop.resize == "point":  # about one, however many there are
        return shot.xp.ones_like(scale)
    share = 4.0 if shot.scene.is_binned_bayer else 1.0
    if shot.scene.develop.resize == "antialias":
        share = share * (2 / 3) ** 2  # a triangle's mean has 4 / 9 of a box's variance
    return (scale * scale / share).clip(min=1)


def lost_noise_variances(shot: ShotGeometry) -> tuple[Any, Any]:
    """Return the variance of sensor pixels' noise that a binned reading has averaged away, (B,)
    each: of read noise, and of photon noise at full scale; of torch or numpy."""
    read, photons = shot.sensor.read_noise**2, shot.sensor.shot_noise**2
    if "noise" not in shot.plan:
        read = photons = shot.xp.zeros_like(read)
    away = 1 - 1 / pixels_per_value(shot, shot.bin_scale)
    return away * read, away * photons


def lost_variances(shot: ShotRecord) -> tuple[Tensor, Tensor, Tensor]:
    """Return the variance of sensor pixels that a binned reading has averaged away: of read noise
    and of photon noise at full scale, (B, 1, 1, 1) each, and of the panel's pattern, as a share of
    the squared reading, (B, 3)."""
    read, photons = (v[:, None, None, None] for v in lost_noise_variances(shot))
    pattern = read.new_zeros(len(read), 3)
    if "saturate" in shot.plan:
        pattern = shot.plan.method.pattern_variance(shot)
    return read, photons, pattern
