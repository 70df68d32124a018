"""White balance and brightness."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.effects.base import Effect, Verdict, judged, off, show
from moireaug.numeric import per_image
from moireaug.scene.record import SceneRecord


class WhiteBalance(Effect):
    """Red and blue times a gain each."""

    name = "balance"

    def verdict(self, scene: SceneRecord) -> Verdict:
        red, blue = scene.develop.red, scene.develop.blue
        why = f"red times {show(red)}, blue {show(blue)}"
        return judged(max(off(red, 1), off(blue, 1)), scene, why, "red and blue as they are read")

    def __call__(self, photo: Tensor, shot) -> Tensor:
        return balance(photo, shot.develop.red, shot.develop.blue)


class Brighten(Effect):
    """A number added to the codes."""

    name = "brighten"

    def verdict(self, scene: SceneRecord) -> Verdict:
        brighten = scene.develop.brighten
        return judged(off(brighten, 0), scene, f"{show(brighten)} added", "nothing to add")

    def __call__(self, photo: Tensor, shot) -> Tensor:
        return photo + per_image(shot.develop.brighten, photo)


def balance(photo: Tensor, red: Tensor, blue: Tensor) -> Tensor:
    """Return (B, 3, H, W) with red and blue times a gain (B,) each."""
    gains = torch.stack([red, torch.ones_like(red), blue], -1).to(photo.dtype)
    return photo * gains[:, :, None, None]
