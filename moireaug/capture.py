"""The capture: a photo of images on a screen, by the engine where it can run and by the reference
elsewhere.

photo = capture(image, shot, noise)                      # the paper's x* = g(x, delta, kappa)
      = develop(expose(image, shot) + noise, shot)       # g2(g1(x) + delta)

An attack computes g1, screen to raw, once, and g2, raw to photo, at every step.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from moireaug.common.image_checks import check_images
from moireaug.common.numeric import widen_half
from moireaug.engine.execution import call_of
from moireaug.engine.stages import developing, exposing
from moireaug.scene.mixed_shot import MixedShot, per_scene
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_checks import (
    check_batch,
    check_is_shot,
    check_noise,
    check_raw,
    check_rows_of_noise,
    checked_numbers,
)


def capture(
    image: Tensor, shot: ShotRecord | MixedShot, noise: Tensor | Sequence[Tensor] | None = None
) -> Tensor:
    """Return the photo of `image` on a screen: the paper's g(x, delta, kappa).

    Args:
        image: (B, 3, H, W) float in [0, 1], sRGB codes. Values a little outside, by rounding,
            overshoot or noise, are clipped, with gradient 1 in [0, 1] and 0 outside;
            `moireaug.common.image_checks` says how much is allowed.
        shot: one draw for B images of this size, from a scene or a mixture of scenes.
        noise: the attacker's delta, a tensor of shape `shot.raw_shape()`, in raw units; added to
            the raw reading, in its dtype and on its device. Of a mixture, also a list of one tensor
            per image: the raw shapes of its scenes may differ.

    Returns:
        (B, 3, H, W) in [0, 1], of the image's dtype. Differentiable in image and noise, and, where
        the plan's exposure is "spectral", "box" or "mean", in every field of the shot whose effect
        the plan has, except the JPEG quality. Forward-mode and `torch.func` derivatives work, too,
        except for scenes with JPEG or the denoiser "nlm": those have ordinary backward gradients
        alone.

    Raises:
        TypeError, ValueError: an image that is not a float batch of three channels, or not a
            picture in [0, 1]: normalised, 0 to 255, NaN, infinite; a device without float64, "mps";
            a shot or noise of another batch or size, or with NaN or infinity; noise that is not a
            floating point tensor.
    """
    return photo_of(check_images(image), shot, noise).to(image.dtype)


def expose(image: Tensor, shot: ShotRecord) -> Tensor:
    """Return the raw reading, the paper's g1, of the shape `shot.raw_shape()`: packed Bayer planes
    R, G, G, B, of half the sensor's size, or of the photo's size where the reading is binned; or
    three colours where the sensor has no colour filters. It includes gain and sensor noise, and is
    clipped to [0, 1] if they can exceed it.

    Arguments, gradients and errors as in `capture`. The reading is float64 for float64
    images, else float32.
    """
    raw = reading_of(check_images(image), shot)
    return raw.clone() if raw is image else raw  # where nothing is called for: it may be written to


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photo of a raw reading, the paper's g2: `shot.raw_shape()` to (B, 3, H, W) in [0,
    1], of the reading's dtype; half precision is computed in float32.

    Differentiable in raw, and in every field of the shot that developing reads, except the JPEG
    quality. On a GPU, the photo of a reading that holds NaN or infinity is NaN.

    Raises:
        TypeError: a raw reading that is not a floating point tensor.
        ValueError: a raw reading of another batch or size than the shot's.
    """
    check_raw(raw, shot)
    return photo_of_reading(raw, shot)


def photo_of(
    image: Tensor, shot: ShotRecord | MixedShot, noise: Tensor | Sequence[Tensor] | None = None
) -> Tensor:
    """Return the photo of images that have passed `check_images` or, in uint8, `check_shape`; of
    float64 for float64 images, else float32. Arguments as in `capture`."""
    check_batch(image.shape, shot)
    if noise is not None and isinstance(shot, MixedShot):
        check_rows_of_noise(noise, shot)
    return per_scene(shot, _photo_in_scene, image, noise)


def _photo_in_scene(shot: ShotRecord, image: Tensor, noise: Tensor | None) -> Tensor:
    """Return the photo of images in one scene; see `photo_of`."""
    table = checked_numbers(shot)
    if noise is not None:
        check_noise(noise, shot)
    light = widen_half(image)
    call = call_of(shot, table, light, noise)
    with torch.autocast(light.device.type, enabled=False):
        expose_light, develop_raw = exposing(call), developing(call, is_finite=True)
        raw = expose_light(light)
        if noise is not None:
            raw = raw + noise.to(raw)
        return develop_raw(raw)


def reading_of(image: Tensor, shot: ShotRecord) -> Tensor:
    """Return the raw reading of images that have passed `check_images` or, in uint8, `check_shape`.
    The engine reads uint8 as it is."""
    check_is_shot(shot)
    check_batch(image.shape, shot)
    light = widen_half(image)
    call = call_of(shot, checked_numbers(shot), light)
    with torch.autocast(light.device.type, enabled=False):
        return exposing(call)(light)


def photo_of_reading(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photo of a reading that has passed `check_raw`; see `develop`."""
    reading = widen_half(raw)
    call = call_of(shot, checked_numbers(shot), reading)
    with torch.autocast(raw.device.type, enabled=False):
        return developing(call)(reading).to(raw.dtype)
