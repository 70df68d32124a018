"""The capture: runs a scene's plan on a batch of images.

photo = capture(image, shot, noise)                      # the paper's x* = g(x, delta, kappa)
      = develop(expose(image, shot) + noise, shot)       # g1: screen to raw, once; g2: raw to photo, at every step
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from moireaug.checks import check_images, check_raw
from moireaug.effects import bayer, noise, tone
from moireaug.effects.denoise import DENOISERS
from moireaug.effects.flicker import flicker
from moireaug.effects.jpeg import jpeg
from moireaug.effects.resize import register, unbent
from moireaug.integrate import in_parts, integral
from moireaug.plan import Plan
from moireaug.shot import Shot


def capture(image: Tensor, shot: Shot, noise: Tensor | None = None) -> Tensor:
    """The photo of `image` on a screen: the paper's g(x, delta, kappa).

    Args:
        image: (B, 3, H, W) float in [0, 1], sRGB codes. What rounding, overshoot or noise left a little outside is
            clipped, with gradient 1 in [0, 1] and 0 outside; `moireaug.checks` says how much is a little.
        shot: one draw for B images of this size.
        noise: the attacker's delta, of shape `shot.raw_shape()`, in raw units; added to the raw reading.

    Returns:
        (B, 3, H, W) in [0, 1], of the image's dtype. Differentiable in image and noise, and, where the plan's exposure
        is "spectral" or "box", in every field of the shot whose effect the plan has, but for the JPEG's quality.

    Raises:
        TypeError, ValueError: an image that is no float batch of three channels, or cannot be a picture in [0, 1]:
            normalised, 0 to 255, NaN, infinite; a shot or noise of another batch or size.
    """
    raw = expose(image, shot)
    if noise is not None:
        if noise.shape != raw.shape:
            raise ValueError(
                f"noise must have the raw reading's shape {tuple(raw.shape)}, see Shot.raw_shape(); "
                f"got {tuple(noise.shape)}."
            )
        if not torch.compiler.is_compiling() and not noise.isfinite().all():
            raise ValueError("noise must be finite; got NaN or infinity. Look for it in the attack's gradients.")
        raw = raw + noise.to(raw)
    return develop(raw, shot).to(image.dtype)


def expose(image: Tensor, shot: Shot) -> Tensor:
    """Screen to raw, the paper's g1: packed Bayer planes (B, 4, h / 2, w / 2), R, G, G, B, or colours (B, 3, h, w)
    where the sensor has no colour filters; with gain and noise, clipped to [0, 1] where these can leave it.

    Arguments, gradients and errors as in `capture`. Half precision is computed in float32, float64 in float64.
    """
    image = check_images(image)
    if len(shot) != len(image) or shot.size != tuple(image.shape[-2:]):
        raise ValueError(
            f"the shot was drawn for {len(shot)} images of {shot.size[0]} x {shot.size[1]}; got {len(image)} of "
            f"{image.shape[-2]} x {image.shape[-1]}. Draw one with scene.sample(len(images), images.shape[-2:])."
        )
    plan, shot = shot.scene.plan(), shot.to(image.device)
    light = image if image.dtype == torch.float64 else image.float()
    with torch.autocast(image.device.type, enabled=False):
        integrate = integral(shot, plan, light.dtype)

        def read(light: Tensor, shot: Shot, rows: slice) -> Tensor:
            if "decode" in plan:
                light = tone.decode(light)
            return _read(integrate(light, rows), shot, plan)

        return in_parts(read, light, shot)


def _read(raw: Tensor, shot: Shot, plan: Plan) -> Tensor:
    """What the sensor makes of the light on its pixels."""
    raw = _attenuate(raw, shot, plan)
    if "shot_noise" in plan:
        raw = noise.sensor_noise(raw, shot.sensor.read_noise, shot.sensor.shot_noise, shot.seed)
    elif "read_noise" in plan:
        raw = noise.read_noise(raw, shot.sensor.read_noise, shot.seed)
    if any(effect in plan for effect in ("saturate", "read_noise", "shot_noise", "flicker")):
        # the reading itself has ended at its bounds, so that an attacker's noise starts where it is felt
        raw = tone.clip(raw)
    return raw


def _attenuate(raw: Tensor, shot: Shot, plan: Plan) -> Tensor:
    """What multiplies the reading: gain, and what differs over the sensor."""
    factor = shot.sensor.gain[:, None, None] if "gain" in plan else None
    lines = [r.positions(raw.device) for r in shot.readouts()]
    if "flicker" in plan:
        panel, sensor = shot.panel, shot.sensor
        rows = lines[0] / shot.size[0]
        bands = flicker(rows, panel.pwm, panel.duty, panel.phase, sensor.shutter, sensor.readout)[:, :, None]
        factor = bands if factor is None else factor * bands
    if "vignetting" in plan:
        dark = tone.falloff(*lines, shot.size, shot.lens.vignetting)
        factor = dark if factor is None else factor * dark
    if factor is None:
        return raw
    factor = factor.to(raw.dtype)
    if factor.shape[-2:] == (1, 1):
        return raw * factor[:, None]
    factor = factor.expand(-1, len(lines[0]), len(lines[1]))
    return raw * (factor[:, None] if shot.scene.sensor.cfa == "none" else bayer.pack(factor))


def develop(raw: Tensor, shot: Shot) -> Tensor:
    """Raw to photo, the paper's g2: `shot.raw_shape()` to (B, 3, H, W) in [0, 1]. Differentiable in raw.

    Raises:
        TypeError, ValueError: a raw reading of another batch, size or number of planes than the shot's.
    """
    check_raw(raw, shot)
    plan, shot = shot.scene.plan(), shot.to(raw.device)
    with torch.autocast(raw.device.type, enabled=False):
        back = _registration(shot, plan)

        def photograph(raw: Tensor, shot: Shot, rows: slice) -> Tensor:
            photo = back(_photo(raw, shot, plan), rows)
            return jpeg(photo, shot.develop.jpeg) if "jpeg" in plan else photo

        return in_parts(photograph, raw, shot)


def _registration(shot: Shot, plan: Plan) -> Callable[[Tensor, slice], Tensor]:
    """What takes a photo of some rows of the batch back to the image's frame."""
    if "register" not in plan:
        return lambda photo, rows: photo
    matrix, affine = shot.matrix(), plan.affine
    factor = unbent(matrix, shot.bends, shot.size, affine=affine)

    def back(photo: Tensor, rows: slice) -> Tensor:
        photo = register(photo, matrix[rows], None if factor is None else factor[rows], affine=affine)
        return tone.clip(photo)  # interpolation rounds, and may end a digit above 1

    return back


def _photo(raw: Tensor, shot: Shot, plan: Plan) -> Tensor:
    """Raw to a photo in the camera's frame."""
    how, (rows, cols) = shot.scene.develop, shot.readouts()
    if "saturate" in plan:
        raw = tone.saturate(raw)
    if "bits" in plan:
        raw = noise.quantise(raw, shot.scene.sensor.bits)
    if "denoise" in plan:
        photo = bayer.demosaic_all(raw, rows, cols, how.demosaic) if "demosaic" in plan else raw
        photo = DENOISERS[how.denoise](_encode(photo, shot, plan))
        return bayer.resize_colour(photo, rows, cols, how.resize)
    if "demosaic" in plan:
        return _encode(bayer.develop_mosaic(raw, rows, cols, how.resize, how.demosaic), shot, plan)
    return _encode(bayer.resize_colour(raw, rows, cols, how.resize), shot, plan)


def _encode(photo: Tensor, shot: Shot, plan: Plan) -> Tensor:
    """Colours as the sensor counts them to codes in [0, 1]."""
    if "balance" in plan:
        photo = tone.balance(photo, shot.develop.red, shot.develop.blue)
    if "encode" in plan:
        photo = tone.encode(photo)
    if "brighten" in plan:
        photo = photo + shot.develop.brighten.to(photo.dtype)[:, None, None, None]
    return tone.clip(photo)
