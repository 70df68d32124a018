"""Light and codes: the sRGB transfer function, gains and the clip to [0, 1]."""

from __future__ import annotations

import torch
from torch import Tensor

# Where each curve goes from its straight part to its power. On CPU `where` and `pow` cost 40 and 20 sums: so what lies
# beyond comes from `relu`, and the power from a logarithm and an exponential.
DIM_CODE, DIM_LIGHT = 0.04045, 0.0031308


def decode(codes: Tensor) -> Tensor:
    """sRGB codes to light."""
    beyond = torch.relu(codes - DIM_CODE)
    power = torch.exp(2.4 * torch.log(beyond / 1.055 + (DIM_CODE + 0.055) / 1.055))
    return torch.lerp(codes / 12.92, power, beyond.detach().sign())


def encode(light: Tensor) -> Tensor:
    """Light to sRGB codes; the straight part below 0.0031308 goes on below zero."""
    beyond = torch.relu(light - DIM_LIGHT)
    power = 1.055 * torch.exp(torch.log(beyond + DIM_LIGHT) / 2.4) - 0.055
    return torch.lerp(12.92 * light, power, beyond.detach().sign())


def clip(x: Tensor) -> Tensor:
    """Clip to [0, 1] with gradient 1 on both bounds and 0 outside.

    `torch.clamp` passes no gradient at its bounds since torch 2.14: black and white pixels would hide from an attack.
    """
    if not x.requires_grad:
        return x.clamp(0, 1)
    return torch.where((x < 0) | (x > 1), x.detach().clamp(min=0, max=1), x)


def saturate(raw: Tensor) -> Tensor:
    """A full well reads 1; gradient as in `clip`."""
    return torch.where(raw > 1, torch.ones_like(raw), raw) if raw.requires_grad else raw.clamp(max=1)


def balance(photo: Tensor, red: Tensor, blue: Tensor) -> Tensor:
    """White balance: the red and blue of (B, 3, H, W) times a gain (B,) each."""
    gains = torch.stack([red, torch.ones_like(red), blue], -1).to(photo.dtype)
    return photo * gains[:, :, None, None]


def falloff(rows: Tensor, cols: Tensor, size: tuple[int, int], loss: Tensor) -> Tensor:
    """Natural vignetting, the fourth power of a ray's cosine, that takes `loss` (B,) of the light in the corners.

    Args:
        rows, cols: (h,) and (w,) photo coordinates. size: height and width of the photo.

    Returns:
        (B, h, w), 1 in the photo's centre.
    """
    h, w = size
    r2 = ((rows - h / 2).square()[:, None] + (cols - w / 2).square()[None, :]) * (4 / (h * h + w * w))
    steep = ((1 - loss) ** -0.5 - 1)[:, None, None]  # the squared tangent of the corner's ray
    return (1 + steep * r2) ** -2
