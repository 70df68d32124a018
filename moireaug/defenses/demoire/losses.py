"""The published training losses, by a network's name.

All take `DemoireNet.outputs` and the target at full size. Their perceptual parts compare features
of VGG-16, whose weights are a file of the user's; without it they are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
import torchvision
from torch import Tensor, nn

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of the images that VGG-16 was trained on
CONV3_3 = 16  # layers up to the ReLU after it
EPSILON = 1e-3  # of Charbonnier's loss

Loss = Callable[[Sequence[Tensor], Tensor, nn.Module | None], Tensor]


class VGGFeatures(nn.Module):
    """VGG-16 up to the ReLU after conv3_3, frozen: (B, 3, H, W) in [0, 1] to (B, 256, H/4, W/4).

    Args:
        path: a state_dict of torchvision's vgg16, as published.

    Raises:
        ValueError: a file that is missing, damaged or of another network.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self.layers = torchvision.models.vgg16().features[:CONV3_3]
        wanted = "Pass a state_dict of torchvision's vgg16."
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            own = {key: state[f"features.{key}"] for key in self.layers.state_dict()}
            self.layers.load_state_dict(own)
        except Exception as error:  # whichever byte was hit, or tensor is missing
            raise ValueError(
                f"vgg: the file {str(path)!r} could not be read as VGG-16 "
                f"({type(error).__name__}). {wanted}"
            ) from error
        self.register_buffer("mean", torch.tensor(MEAN).view(-1, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).view(-1, 1, 1), persistent=False)
        self.eval().requires_grad_(False)

    def forward(self, images: Tensor) -> Tensor:
        return self.layers((images - self.mean) / self.std)


def esdnet(outputs: Sequence[Tensor], target: Tensor, features: nn.Module | None = None) -> Tensor:
    """Compute ESDNet's loss (section 4.3, equation 4): L1 and, by weight 1, the L1 distance of
    VGG-16's features after conv3_3, summed over the three scales.

    Args:
        outputs: of `DemoireNet.outputs`.
        target: (B, 3, H, W) in [0, 1]; brought to the coarser scales bilinearly.
        features: a `VGGFeatures`; None leaves the perceptual part out.
    """
    total = target.new_zeros(())
    for output in outputs:
        wanted = _resized(target, output)
        total = total + F.l1_loss(output, wanted)
        if features is not None:
            total = total + F.l1_loss(features(output), features(wanted))
    return total


def charbonnier(output: Tensor, target: Tensor) -> Tensor:
    """Compute the mean of sqrt((output - target)^2 + 1e-6), an L1 that is smooth at 0."""
    return ((output - target).square() + EPSILON**2).sqrt().mean()


LOSSES: dict[str, Loss] = {"esdnet": esdnet}


def _resized(x: Tensor, like: Tensor) -> Tensor:
    if x.shape == like.shape:
        return x
    return F.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)
