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

from moireaug.camera import pipeline
from moireaug.common.image_checks import check_images
from moireaug.common.numeric import as_float, as_single
from moireaug.engine import dispatch
from moireaug.engine.program import program_of_call
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_checks import (
    check_batch,
    check_noise,
    check_noise_shape,
    check_raw,
    check_rows_of_noise,
    check_shot,
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
            picture in [0, 1]: normalised, 0 to 255, NaN, infinite; a shot or noise of another batch
            or size, or with NaN or infinity; noise that is not a floating point tensor.
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
    quality.

    Raises:
        TypeError: a raw reading that is not a floating point tensor.
        ValueError: a raw reading of another batch or size than the shot's.
    """
    check_raw(raw, shot)
    return photo_of_reading(raw, shot)


def photo_of_reading(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photo of a reading of a shot that has been checked; see `develop`."""
    reading = as_single(raw)
    with torch.autocast(raw.device.type, enabled=False):
        program = program_of_call(reading, shot)
        if program.why_not_develop:
            return pipeline.develop(reading, shot).to(raw.dtype)
        return dispatch.engine_photo(reading, shot, program).to(raw.dtype)


def photo_of(
    image: Tensor, shot: ShotRecord | MixedShot, noise: Tensor | Sequence[Tensor] | None = None
) -> Tensor:
    """Return the photo of `image`, of its reading's dtype; arguments as in `reading_of` and
    `capture`."""
    if isinstance(shot, MixedShot):
        return _mixed_photo_of(image, shot, noise)
    raw = reading_of(image, shot)
    if noise is not None:
        raw = raw + check_noise(noise, raw).to(raw)
    return photo_of_reading(raw, shot)


def _mixed_photo_of(
    image: Tensor, shot: MixedShot, noise: Tensor | Sequence[Tensor] | None
) -> Tensor:
    """Return the photos of a mixture, those of each scene taken together; see `photo_of`."""
    check_batch(image.shape, shot)
    if noise is not None:
        check_rows_of_noise(noise, shot)

    def photo(rows: Tensor, part: ShotRecord) -> Tensor:
        chosen = _rows_of_noise(noise, rows, part.raw_shape()[1:])
        return photo_of(image[rows.to(image.device)], part, chosen)

    return shot.map_shots(photo)


def _rows_of_noise(
    noise: Tensor | Sequence[Tensor] | None, rows: Tensor, shape: tuple[int, ...]
) -> Tensor | None:
    """Return the noise of some images of a mixture, or None; shape: of each one's raw reading."""
    if isinstance(noise, Tensor):
        return noise[rows.to(noise.device)]
    if noise is None or not len(rows):
        return None
    chosen = rows.tolist()
    for row in chosen:
        check_noise_shape(f"noise[{row}]", noise[row], shape)
    return torch.stack([noise[row] for row in chosen])


def reading_of(image: Tensor, shot: ShotRecord) -> Tensor:
    """Return the raw reading of images that have passed `check_images` or, in uint8, `check_shape`.
    The engine reads uint8 as it is."""
    check_shot(image.shape, shot)
    light = as_single(image)
    with torch.autocast(image.device.type, enabled=False):
        program = program_of_call(light, shot)
        if program.why_not_expose:
            return pipeline.expose(as_float(light), shot)
        return dispatch.engine_reading(light, shot, program)
