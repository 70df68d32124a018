"""The likeness of two pictures: PSNR and SSIM, as they are or after the best colour map."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.evaluation.visibility import psnr, ssim
from training.photographs.tone import ColourMap


def map_colours(picture: Tensor, target: Tensor) -> Tensor:
    """Return a picture (3, H, W) in [0, 1] after the best global colour map onto another."""
    codes, aim = (255 * side.float().cpu().contiguous().numpy() for side in (picture, target))
    return torch.from_numpy(ColourMap.fit(codes, aim)(codes)) / 255


def fidelity_scores(picture: Tensor, target: Tensor) -> dict[str, float]:
    """Return `psnr` in dB and `ssim` of a picture (3, H, W) in [0, 1] against another, and with the
    prefix `mapped_` those after the best global colour map."""
    scores = {}
    for prefix, candidate in (("", picture), ("mapped_", map_colours(picture, target))):
        scores[f"{prefix}psnr"] = float(psnr(candidate[None], target[None]))
        scores[f"{prefix}ssim"] = float(ssim(candidate[None], target[None]))
    return scores
