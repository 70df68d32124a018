"""How near pictures are to others: PSNR and SSIM, as they are or after the best colour map."""

from __future__ import annotations

import torch
from kornia.metrics import ssim as ssim_map
from torch import Tensor

from moireaug.synthesis.tone import ColourMap

WINDOW = 11  # pixels, as published


def psnr(pictures: Tensor, wanted: Tensor) -> Tensor:
    """Return the peak signal-to-noise ratio in dB of each of (B, 3, H, W) in [0, 1]; 100 at most,
    as of equal pictures."""
    error = (pictures.double() - wanted.double()).square().mean((1, 2, 3))
    return -10 * torch.log10(error.clamp(min=1e-10))


def ssim(pictures: Tensor, wanted: Tensor) -> Tensor:
    """Return the structural similarity of each of (B, 3, H, W) in [0, 1]: the mean over pixels and
    channels, windows of 11 pixels."""
    return ssim_map(pictures.float(), wanted.float(), WINDOW).mean((1, 2, 3))


def mapped(picture: Tensor, wanted: Tensor) -> Tensor:
    """Return a picture (3, H, W) in [0, 1] after the best global colour map onto another."""
    codes, aim = (255 * side.float().cpu().contiguous().numpy() for side in (picture, wanted))
    return torch.from_numpy(ColourMap.fit(codes, aim)(codes)) / 255


def fidelity(picture: Tensor, wanted: Tensor) -> dict[str, float]:
    """Return `psnr` and `ssim` of one picture (3, H, W), and with `mapped_` before them those after
    the best global colour map."""
    found = {}
    for prefix, shown in (("", picture), ("mapped_", mapped(picture, wanted))):
        found[f"{prefix}psnr"] = float(psnr(shown[None], wanted[None]))
        found[f"{prefix}ssim"] = float(ssim(shown[None], wanted[None]))
    return found
