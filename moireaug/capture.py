"""The capture: runs a scene's plan on a batch of images.

photo = capture(image, shot, noise)                      # the paper's x* = g(x, delta, kappa)
      = develop(expose(image, shot) + noise, shot)       # g1: screen to raw, once; g2: raw to photo, at every step
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.effects import bayer, exposure, noise, tone
from moireaug.effects.panel import LAYOUTS
from moireaug.effects.resize import register
from moireaug.effects.view import jacobian, look, nodes
from moireaug.fields import bounds
from moireaug.plan import Plan
from moireaug.shot import Shot

METHODS = {
    "spectral": exposure.spectral,
    "mean": exposure.spectral,
    "point": exposure.point,
    "supersample": exposure.supersample,
}


def capture(image: Tensor, shot: Shot, noise: Tensor | None = None) -> Tensor:
    """The photo of `image` on a screen: the paper's g(x, delta, kappa).

    Args:
        image: (B, 3, H, W) float in [0, 1], sRGB codes.
        shot: one draw for B images of this size.
        noise: the attacker's delta, of shape `shot.raw_shape()`, in raw units; added to the raw reading.

    Returns:
        (B, 3, H, W) in [0, 1], of the image's dtype. Differentiable in image and noise, and, where the plan's exposure
        is "spectral", in every field of the shot whose effect the plan has.

    Raises:
        TypeError, ValueError: an image that is no float batch of three channels in [0, 1], NaN, or a shot or noise of
            another batch or size.
    """
    raw = expose(image, shot)
    if noise is not None:
        if noise.shape != raw.shape:
            raise ValueError(
                f"noise must have the raw reading's shape {tuple(raw.shape)}, see Shot.raw_shape(); "
                f"got {tuple(noise.shape)}."
            )
        raw = raw + noise.to(raw)
    return develop(raw, shot).to(image.dtype)


def expose(image: Tensor, shot: Shot) -> Tensor:
    """Screen to raw, the paper's g1: packed Bayer planes (B, 4, h / 2, w / 2), R, G, G, B, with gain and read noise,
    clipped to [0, 1] where these can leave it.

    Arguments, gradients and errors as in `capture`. Half precision is computed in float32, float64 in float64.
    """
    check_images(image)
    if len(shot) != len(image) or shot.size != tuple(image.shape[-2:]):
        raise ValueError(
            f"the shot was drawn for {len(shot)} images of {shot.size[0]} x {shot.size[1]}; got {len(image)} of "
            f"{image.shape[-2]} x {image.shape[-1]}. Draw one with scene.sample(len(images), images.shape[-2:])."
        )
    plan, shot = shot.scene.plan(), shot.to(image.device)
    light = image if image.dtype == torch.float64 else image.float()
    with torch.autocast(image.device.type, enabled=False):
        if "decode" in plan:
            light = tone.decode(light)
        raw = _integrate(light, shot, plan)
        if "gain" in plan:
            raw = raw * shot.sensor.gain.to(raw.dtype)[:, None, None, None]
        if "read_noise" in plan:
            raw = noise.read_noise(raw, shot.sensor.read_noise, shot.seed)
        if "saturate" in plan or "read_noise" in plan:
            # the reading itself has ended at its bounds, so that an attacker's noise starts where it is felt
            raw = tone.clip(raw)
    return raw


def develop(raw: Tensor, shot: Shot) -> Tensor:
    """Raw to photo, the paper's g2: (B, 4, h / 2, w / 2) to (B, 3, H, W) in [0, 1]. Differentiable in raw."""
    plan, shot = shot.scene.plan(), shot.to(raw.device)
    with torch.autocast(raw.device.type, enabled=False):
        if "saturate" in plan:
            raw = tone.saturate(raw)
        photo = bayer.develop_mosaic(raw, *shot.readouts(), shot.scene.develop.resize)
        if "encode" in plan:
            photo = tone.encode(photo)
        if "brighten" in plan:
            photo = photo + shot.develop.brighten.to(photo.dtype)[:, None, None, None]
        photo = tone.clip(photo)
        if "register" in plan:
            photo = register(photo, shot.matrix(), shot.bends, affine=plan.affine)
    return photo


def _integrate(light: Tensor, shot: Shot, plan: Plan) -> Tensor:
    """Panel light (B, 3, H, W) integrated over each Bayer site that the photo reads: (B, 4, h / 2, w / 2)."""
    dark = not shot.scene.develop.registered  # a registered photo is cut out of a screen that goes on past the picture
    inverse = torch.linalg.inv(shot.matrix())
    readouts = shot.readouts()
    rows, cols = (r.positions(light.device) for r in readouts)
    dtype = _coordinate_dtype(shot, plan, light.dtype)
    settings = {
        "layout": LAYOUTS[shot.scene.panel.layout],
        "alpha": shot.panel.scale,
        "lit": shot.panel.lit,
        "dark": dark,
    }
    if plan.exposure in ("spectral", "mean"):
        settings |= {"harmonics": plan.harmonics, "amplitude": _amplitude(shot, plan, inverse, rows, cols, light.dtype)}
    method, _, n = plan.exposure.partition(":")
    aperture = [(0.0, 0.0)]
    if n:
        u = exposure.aperture_points(int(n), shot.sensor.fill, shot.lens.blur)
        dv, du = (u / r.scale for r in readouts)
        aperture = [(dv[:, i, None], du[:, j, None]) for i in range(int(n)) for j in range(int(n))]
    planes = []
    for channel, (r, c) in zip(bayer.CHANNELS, bayer.CELL, strict=True):
        plane, total = light[:, channel : channel + 1], 0.0
        for dv, du in aperture:
            v, u = (rows[r::2] + dv).to(dtype), (cols[c::2] + du).to(dtype)
            x, y = look(inverse, v, u, shot.size, affine=plan.affine, lens=shot.bends)
            total = total + METHODS[method](plane, channel, x, y, **settings)
        planes.append(total / len(aperture))
    return torch.stack(planes, 1)


def _amplitude(
    shot: Shot, plan: Plan, inverse: Tensor, rows: Tensor, cols: Tensor, dtype: torch.dtype
) -> Tensor | None:
    """The harmonics' amplitudes for every 2 x 2 cell of the raster; one number each where the view is affine."""
    if not plan.harmonics:
        return None
    flat = plan.affine and shot.bends is None
    lattice = (rows[:1], cols[:1]) if flat else (nodes(rows), nodes(cols))
    j = jacobian(inverse, *lattice, shot.size, lens=shot.bends)
    pitch = shot.panel.scale / shot.readouts()[0].scale
    fields = shot.sensor.fill, shot.lens.blur, shot.panel.lit
    a = exposure.amplitudes(LAYOUTS[shot.scene.panel.layout], plan.harmonics, j, pitch, *fields).to(dtype)
    if flat:
        return a
    return F.interpolate(a, size=(len(rows) // 2, len(cols) // 2), mode="bilinear", align_corners=True)


def _coordinate_dtype(shot: Shot, plan: Plan, dtype: torch.dtype) -> torch.dtype:
    """float32 where its rounding of the fastest phase stays under half the tolerance, else float64."""
    order = max((abs(k) + abs(l) for k, l in plan.harmonics), default=1)
    cycles = max(shot.size) * bounds(shot.scene.panel.scale)[1] * order
    return dtype if cycles * 2 * math.pi * torch.finfo(dtype).eps < shot.scene.tolerance / 2 else torch.float64


def check_images(image: Tensor) -> None:
    """Refuse what is no float batch (B, 3, H, W) of finite values in [0, 1].

    Raises:
        TypeError, ValueError: with what was got, what is allowed and what to do.
    """
    if not isinstance(image, Tensor):
        raise TypeError(
            f"images must be a torch.Tensor; got {type(image).__name__}. Use moireaug.transforms for PIL and numpy."
        )
    if not image.is_floating_point():
        raise TypeError(
            f"images must be floating point in [0, 1]; got {image.dtype}. Divide uint8 images by 255, or use "
            "moireaug.transforms.RandomMoire, which takes them as they are."
        )
    if image.ndim != 4 or image.shape[1] != 3 or 0 in image.shape[-2:]:
        raise ValueError(f"images must have the shape (B, 3, H, W) with H, W >= 1; got {tuple(image.shape)}.")
    if image.numel() and not torch.compiler.is_compiling():
        low, high = (v.item() for v in image.detach().aminmax())
        if not (low >= 0 and high <= 1):
            raise ValueError(
                f"images must be finite and lie in [0, 1]; got values from {low:g} to {high:g}. "
                "Undo the normalisation first: put it into the model with attacks.Normalized."
            )
