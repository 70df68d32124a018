"""Sensor pixels to photo pixels, on codes, as apps and data pipelines do it."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from moireaug.effects.base import Effect, Verdict, called, left_out
from moireaug.geometry.sensor import SampledPixels
from moireaug.numeric import bounded
from moireaug.scene.record import SceneRecord


class Resize(Effect):
    """Resizes the photo to the size of the image."""

    name = "resize"

    def verdict(self, scene: SceneRecord) -> Verdict:
        scale = scene.sensor.scale
        if scale == 1:
            return left_out("one sensor pixel per photo pixel")
        return called(f"{scene.develop.resize}, {scale:g} sensor pixels per photo pixel")

    def __call__(self, photo: Tensor, shot) -> Tensor:
        rows, cols = shot.sampled_pixels()
        return bounded(resize(photo, rows, cols, shot.scene.develop.resize))


def resize(photo: Tensor, rows: SampledPixels, cols: SampledPixels, how: str) -> Tensor:
    """Return the pixels that were read (B, 3, h, w) as photo pixels (B, 3, H, W)."""
    step = rows.step
    if step == 1:
        return photo
    if step and how == "point":
        return window_centres(photo, step)
    if step:
        return F.avg_pool2d(photo, step)
    size = rows.size, cols.size
    if how == "area":
        return F.interpolate(photo, size=size, mode="area")
    antialias = how == "antialias"
    if antialias and cols.size == 1:  # torch's antialiased single column is another picture
        return bilinear(photo.mT, size[::-1], antialias=True).mT
    return bilinear(photo, size, antialias=antialias)


def bilinear(photo: Tensor, size: tuple[int, int], *, antialias: bool) -> Tensor:
    """Return a photo (B, 3, h, w) interpolated to another size (H, W)."""
    return F.interpolate(
        photo, size=size, mode="bilinear", align_corners=False, antialias=antialias
    )


def window_centres(photo: Tensor, step: int) -> Tensor:
    """Return the mean of the 1 x 1 (odd step) or 2 x 2 (even step) pixels in the centre of each
    window."""
    across = 1 if step % 2 else 2
    first = (step - across) // 2
    windows = photo.unfold(2, step, step).unfold(3, step, step)
    return windows[..., first : first + across, first : first + across].mean((-1, -2))
