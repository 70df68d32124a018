"""Visibility of a change: PSNR, SSIM, CIEDE2000, LPIPS."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import torch
from kornia.metrics import ssim as ssim_map
from skimage.color import deltaE_ciede2000, rgb2lab
from torch import Tensor, nn

from moireaug.common.weights import float32_on_cpu, read_features

# torchvision's name of each network that LPIPS has linear heads for, to torchmetrics' name of it,
# and the least side of an image that passes all of its layers
LPIPS_NETWORKS: dict[str, tuple[Literal["squeeze", "alex", "vgg"], int]] = {
    "squeezenet1_1": ("squeeze", 17),
    "alexnet": ("alex", 31),
    "vgg16": ("vgg", 16),
}
PAIRS_PER_PASS = 8  # of images through the network
SSIM_WINDOW = 11  # pixels


class LPIPS(nn.Module):
    """Learned perceptual image patch similarity (Zhang et al., 2018): how far two images lie apart
    in the features of a network, 0 for the same image.

    The linear heads are the authors' version 0.1, which torchmetrics brings; the features are
    those of the given file, so that nothing is downloaded.

    Args:
        path: state_dict of torchvision's squeezenet1_1, alexnet or vgg16, as published; its tensors
            tell which.

    Attributes:
        network: torchvision's name of the network.
        min_side: side of the smallest image that it takes, in pixels.

    Raises:
        ValueError: a file that is missing, damaged or of another network.
    """

    def __init__(self, path: str | Path) -> None:
        from torchmetrics.functional.image.lpips import _LPIPS  # takes seconds to import

        super().__init__()
        self.network, layers = read_features(path, "lpips", tuple(LPIPS_NETWORKS))
        name, self.min_side = LPIPS_NETWORKS[self.network]
        # the network's random weights are replaced
        with torch.random.fork_rng(devices=[]), float32_on_cpu():
            self.model = _LPIPS(net=name, pnet_rand=True)
        own, features = self.model.net.state_dict(), layers.state_dict()
        # "slice2.3.bias" or "slices.1.3.bias" of torchmetrics is torchvision's "features.3.bias"
        for key in own:
            own[key] = features[key.removeprefix("slices.").partition(".")[2]]
        self.model.net.load_state_dict(own)

    def forward(self, changed: Tensor, original: Tensor) -> Tensor:
        """Return the distance of two images (B, 3, H, W) in [0, 1], (B,) float32."""
        distances = []
        for a, b in zip(changed.split(PAIRS_PER_PASS), original.split(PAIRS_PER_PASS), strict=True):
            distances.append(self.model(a.float(), b.float(), normalize=True).flatten())
        return torch.cat(distances)

    def require_side(self, side: int) -> None:
        """Refuse images whose shorter side, in pixels, is too small for the network: ValueError."""
        if side < self.min_side:
            raise ValueError(
                f"lpips: {self.network} takes images of at least {self.min_side} x {self.min_side} "
                f"pixels; got a side of {side}. Use vgg16, which takes 16, or leave lpips out."
            )


def visibility(
    changed: Tensor, original: Tensor, lpips: nn.Module | None = None
) -> dict[str, list[float]]:
    """Measure the visibility of a change of images (B, 3, H, W) in [0, 1], image by image.

    Args:
        lpips: an `LPIPS`, where its weights are given.

    Returns:
        `psnr` in dB, at most 100, which stands for no difference; `ssim`, windows of 11 pixels;
        `ciede2000`, the mean colour difference (1 is just noticeable side by side); `largest`, the
        greatest change of a code, in [0, 1]; and `lpips` where it is given.
    """
    a, b = (x.detach().double().cpu() for x in (changed, original))
    colour = []
    for one, other in zip(a.numpy(), b.numpy(), strict=True):
        lab, lab_before = (rgb2lab(np.moveaxis(x, 0, -1)) for x in (one, other))
        colour.append(float(deltaE_ciede2000(lab, lab_before).mean()))
    figures = {
        "psnr": psnr(a, b).tolist(),
        "ssim": ssim(a, b).tolist(),
        "ciede2000": colour,
        "largest": (a - b).abs().amax((1, 2, 3)).tolist(),
    }
    if lpips is not None:
        with torch.no_grad():
            figures["lpips"] = lpips.to(changed.device)(changed, original).tolist()
    return figures


def psnr(changed: Tensor, original: Tensor) -> Tensor:
    """Return the peak signal-to-noise ratio of each of (B, 3, H, W) in [0, 1], (B,) float64 in dB;
    at most 100, as for equal images."""
    error = (changed.double() - original.double()).square().mean((1, 2, 3))
    return -10 * torch.log10(error.clamp(min=1e-10))


def ssim(changed: Tensor, original: Tensor) -> Tensor:
    """Return the structural similarity of each of (B, 3, H, W) in [0, 1], (B,): the mean over
    pixels and channels, in windows of `SSIM_WINDOW` pixels, or of as many as smaller images have
    when mirrored."""
    window = min(SSIM_WINDOW, 2 * min(changed.shape[-2:]) - 1)
    return ssim_map(changed, original, window).mean((1, 2, 3))
