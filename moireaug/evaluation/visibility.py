"""How visible a change is: the four figures that papers give."""

from __future__ import annotations

import numpy as np
import torch
from kornia.metrics import ssim
from skimage.color import deltaE_ciede2000, rgb2lab
from torch import Tensor


def visibility(changed: Tensor, original: Tensor) -> dict[str, float]:
    """Means over a batch of how far two sets of images (B, 3, H, W) in [0, 1] lie apart.

    Returns:
        `psnr` in dB, at most 100, which stands for no difference; `ssim`, windows of 11 pixels; `ciede2000`, the mean
        colour difference (1 is just noticeable side by side); `largest`, the greatest change of a code, in [0, 1].
    """
    a, b = (x.detach().double().cpu() for x in (changed, original))
    error = (a - b).square().mean((1, 2, 3))
    lab = [rgb2lab(np.moveaxis(x.numpy(), 1, -1)) for x in (a, b)]
    return {
        "psnr": (-10 * torch.log10(error.clamp(min=1e-10))).mean().item(),
        "ssim": ssim(a, b, 11).mean().item(),
        "ciede2000": float(deltaE_ciede2000(*lab).mean()),
        "largest": (a - b).abs().amax((1, 2, 3)).mean().item(),
    }
