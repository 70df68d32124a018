"""How close two pictures are: PSNR and SSIM, as they are or after the best colour map."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.evaluation.visibility import psnr, ssim
from moireaug.synthesis.tone import ColourMap


def mapped(picture: Tensor, wanted: Tensor) -> Tensor:
    """Return a picture (3, H, W) in [0, 1] after the best global colour map onto another."""
    codes, aim = (255 * side.float().cpu().contiguous().numpy() for side in (picture, wanted))
    return torch.from_numpy(ColourMap.fit(codes, aim)(codes)) / 255


def fidelity(picture: Tensor, wanted: Tensor) -> dict[str, float]:
    """Return `psnr` in dB and `ssim` of a picture (3, H, W) in [0, 1] against another, and with the
    prefix `mapped_` those after the best global colour map."""
    found = {}
    for prefix, shown in (("", picture), ("mapped_", mapped(picture, wanted))):
        found[f"{prefix}psnr"] = float(psnr(shown[None], wanted[None]))
        found[f"{prefix}ssim"] = float(ssim(shown[None], wanted[None]))
    return found
