"""How visible a change is: the four figures that papers give."""

from __future__ import annotations

import numpy as np
import torch
from kornia.metrics import ssim
from skimage.color import deltaE_ciede2000, rgb2lab
from torch import Tensor


def visibility(changed: Tensor, original: Tensor) -> dict[str, list[float]]:
    """Measure how far two sets of images (B, 3, H, W) in [0, 1] lie apart, image by image.

    Returns:
        `psnr` in dB, at most 100, which stands for no difference; `ssim`, windows of 11 pixels;
        `ciede2000`, the mean colour difference (1 is just noticeable side by side); `largest`, the
        greatest change of a code, in [0, 1].
    """
    a, b = (x.detach().double().cpu() for x in (changed, original))
    error = (a - b).square().mean((1, 2, 3))
    colour = []
    for one, other in zip(a.numpy(), b.numpy(), strict=True):
        lab, lab_before = (rgb2lab(np.moveaxis(x, 0, -1)) for x in (one, other))
        colour.append(float(deltaE_ciede2000(lab, lab_before).mean()))
    return {
        "psnr": (-10 * torch.log10(error.clamp(min=1e-10))).tolist(),
        "ssim": ssim(a, b, 11).mean((1, 2, 3)).tolist(),
        "ciede2000": colour,
        "largest": (a - b).abs().amax((1, 2, 3)).tolist(),
    }
