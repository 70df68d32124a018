"""Light and codes: the sRGB transfer function and the clip to [0, 1]."""

from __future__ import annotations

import torch
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from torch import Tensor

decode = rgb_to_linear_rgb  # sRGB codes to light, (*, 3, H, W)
encode = linear_rgb_to_rgb  # light to sRGB codes; the straight part below 0.0031308 goes on below zero


def clip(x: Tensor) -> Tensor:
    """Clip to [0, 1] with gradient 1 on both bounds and 0 outside.

    `torch.clamp` passes no gradient at its bounds since torch 2.14: black and white pixels would hide from an attack.
    """
    return torch.where((x < 0) | (x > 1), x.detach().clamp(min=0, max=1), x)


def saturate(raw: Tensor) -> Tensor:
    """A full well reads 1; gradient as in `clip`."""
    return torch.where(raw > 1, torch.ones_like(raw), raw)
