"""MDDM (Cheng, Fu and Yang, "Multi-scale Dynamic Feature Encoding Network for Image Demoiréing",
ICCV workshops 2019)."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor, nn

from moireaug.defenses.demoire.base import DemoireNet, scaled
from moireaug.defenses.demoire.layers import REGION_SIDE, ChannelAttention, RegionAttention, conv

BRANCH_CHANNELS = 64
BRANCH_BLOCKS = (6, 12, 18, 27)  # residual blocks of each branch, the finest first
VARIANCE_EPSILON = 1e-5  # of the variances in AdaIN

prelu_conv = partial(conv, activation=nn.PReLU)


class MDDM(DemoireNet):
    """Branches at full, half, quarter and eighth size, each of residual blocks with channel
    attention whose features take the statistics of a second, encoding path; the branches' images
    are weighted and added up.

    Source: strided convolutions between the branches, sub-pixel convolutions after them and a
    learned factor each (multi-scale); squeeze and excitation, reduction 16, and AdaIN from a bypass
    of convolutions (dynamic feature encoding); a region-level non-local layer before each branch's
    own residual; PReLU. The paper's layer counts were not available. Chosen here, to agree with the
    published 8.01 million parameters: 64 channels, one convolution a block in the bypass, regions
    of 8 x 8 pixels, and 6, 12, 18 and 27 blocks in four branches. The branches predict changes.
    """

    name = "mddm"
    multiple = 2 ** (len(BRANCH_BLOCKS) - 1) * REGION_SIDE

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        channels = scaled(BRANCH_CHANNELS, width)
        self.head = prelu_conv(3, channels)
        self.downs = nn.ModuleList()
        self.branches = nn.ModuleList()
        self.tails = nn.ModuleList()
        for level, blocks in enumerate(BRANCH_BLOCKS):
            if level:
                self.downs.append(prelu_conv(channels, channels, stride=2))
            self.branches.append(Branch(channels, blocks))
            self.tails.append(_tail(channels, level))
        self.factors = nn.Parameter(torch.full((len(BRANCH_BLOCKS),), 1 / len(BRANCH_BLOCKS)))

    def predict(self, images: Tensor) -> tuple[Tensor, ...]:
        x = self.head(images)
        total = images
        for level, branch in enumerate(self.branches):
            if level:
                x = self.downs[level - 1](x)
            total = total + self.factors[level] * self.tails[level](branch(x))
        return (total,)


class Branch(nn.Module):
    """Residual blocks at one scale beside the path that encodes their statistics, a non-local
    layer, and the branch's own residual."""

    def __init__(self, channels: int, blocks: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([DynamicResidual(channels) for _ in range(blocks)])
        self.region = RegionAttention(channels)

    def forward(self, x: Tensor) -> Tensor:
        features, encoded = x, x
        for block in self.blocks:
            features, encoded = block(features, encoded)
        return x + self.region(features)


class DynamicResidual(nn.Module):
    """Channel attention dynamic feature encoding residual block: (B, C, H, W) of the main path and
    of the encoding path to both again."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.encode = prelu_conv(channels, channels)
        first, last = prelu_conv(channels, channels), nn.Conv2d(channels, channels, 3, padding=1)
        self.body = nn.Sequential(*first, last, ChannelAttention(channels))

    def forward(self, x: Tensor, encoded: Tensor) -> tuple[Tensor, Tensor]:
        encoded = self.encode(encoded)
        return x + adain(self.body(x), encoded), encoded


def adain(x: Tensor, like: Tensor) -> Tensor:
    """Give features the mean and the standard deviation of others, channel by channel (Huang and
    Belongie, ICCV 2017); both (B, C, H, W)."""
    mean, deviation = _statistics(x)
    target_mean, target_deviation = _statistics(like)
    return (x - mean) / deviation * target_deviation + target_mean


def _statistics(x: Tensor) -> tuple[Tensor, Tensor]:
    variance, mean = torch.var_mean(x, (2, 3), correction=0, keepdim=True)
    return mean, (variance + VARIANCE_EPSILON).sqrt()


def _tail(channels: int, level: int) -> nn.Sequential:
    """Return sub-pixel convolutions back to full size, and one to an image."""
    layers: list[nn.Module] = []
    for _ in range(level):
        layers += [nn.Conv2d(channels, 4 * channels, 3, padding=1), nn.PixelShuffle(2), nn.PReLU()]
    layers.append(nn.Conv2d(channels, 3, 3, padding=1))
    return nn.Sequential(*layers)
