"""The published training losses, by a network's name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.attacks.model import Normalized
from moireaug.common.weights import read_features
from moireaug.defenses.demoire.layers import resized
from moireaug.defenses.demoire.mopnet import sobel

FEATURE_DEPTHS = {"mopnet": 4}  # layers of VGG-16 up to the ReLU after conv1_2
DEFAULT_FEATURE_DEPTH = 16  # up to the ReLU after conv3_3
NETWORKS_WITHOUT_FEATURES = ("mddm",)  # whose loss compares none
COARSE_SIDES = (2, 4, 8)  # pixels
CHARBONNIER_EPSILON = 1e-3  # added to the difference, in quadrature
MOPNET_FEATURE_WEIGHT = 0.1

Loss = Callable[[Sequence[Tensor], Tensor, nn.Module | None], Tensor]


class VGGFeatures(nn.Module):
    """VGG-16 up to the layer that the loss of a network of this name compares, frozen: (B, 3, H, W)
    in [0, 1] to features, (B, 256, H/4, W/4) after conv3_3 or (B, 64, H, W) after MopNet's conv1_2.

    path: a state_dict of torchvision's vgg16; one that is missing, damaged or of another network is
        refused: ValueError.
    """

    def __init__(self, path: str | Path, network: str) -> None:
        super().__init__()
        _, layers = read_features(path, "vgg", ("vgg16",))
        depth = FEATURE_DEPTHS.get(network, DEFAULT_FEATURE_DEPTH)
        self.layers = Normalized(layers[:depth])
        self.eval().requires_grad_(False)

    def forward(self, images: Tensor) -> Tensor:
        return self.layers(images)


def esdnet(outputs: Sequence[Tensor], target: Tensor, features: nn.Module | None = None) -> Tensor:
    """Compute ESDNet's loss (section 4.3): L1 and, with weight 1, the L1 distance of VGG-16's
    features after conv3_3, summed over the three scales; a scalar, differentiable in outputs.

    Args:
        outputs: of `DemoireNet.outputs`.
        target: (B, 3, H, W) in [0, 1]; brought to coarser scales bilinearly.
        features: a `VGGFeatures`; None leaves the perceptual part out.
    """
    total = target.new_zeros(())
    for output in outputs:
        wanted = resized(target, output)
        total = total + F.l1_loss(output, wanted)
        if features is not None:
            total = total + F.l1_loss(features(output), features(wanted))
    return total


def mddm(outputs: Sequence[Tensor], target: Tensor, features: nn.Module | None = None) -> Tensor:
    """Compute MDDM's loss: Charbonnier's, the mean of sqrt((output - target)^2 + 1e-6), an L1 that
    is smooth at 0; `features` are not used. Args: as `esdnet`."""
    return ((outputs[0] - target).square() + CHARBONNIER_EPSILON**2).sqrt().mean()


def mopnet(outputs: Sequence[Tensor], target: Tensor, features: nn.Module | None = None) -> Tensor:
    """Compute MopNet's loss: mean square error of the image and of the edges, and of VGG-16's
    features after conv1_2 with the paper's weight 0.1. Args: as `esdnet`."""
    image, edges = outputs
    total = F.mse_loss(image, target) + F.mse_loss(edges, sobel(target))
    if features is not None:
        total = total + MOPNET_FEATURE_WEIGHT * F.mse_loss(features(image), features(target))
    return total


def amnet(outputs: Sequence[Tensor], target: Tensor, features: nn.Module | None = None) -> Tensor:
    """Compute ESDNet's loss, and the L1 distance of colours, R - G and B - G, and of image and
    colours averaged over 2, 4 and 8 pixels, in which moiré is coarser than detail; AMNet's own,
    adversarial loss was not available. Args: as `esdnet`."""
    error = outputs[0] - target
    colours = error[:, ::2] - error[:, 1:2]
    total = esdnet(outputs, target, features) + colours.abs().mean()
    for side in COARSE_SIDES:
        total = total + F.avg_pool2d(torch.cat([error, colours], 1), side).abs().mean()
    return total


# FHDe2Net's exact loss weights were not available: its stages are held to L1 like ESDNet's scales
LOSSES: dict[str, Loss] = {
    "mopnet": mopnet,
    "mddm": mddm,
    "fhde2net": esdnet,
    "amnet": amnet,
    "esdnet": esdnet,
}
