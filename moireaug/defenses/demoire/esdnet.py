"""ESDNet (Yu et al., "Towards Efficient and Scale-Robust Ultra-High-Definition Image Demoiréing",
ECCV 2022)."""

from __future__ import annotations

import itertools
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.defenses.demoire.base import DemoireNet, scaled
from moireaug.defenses.demoire.layers import Residual, conv, resized

ENCODER_CHANNELS, DECODER_CHANNELS = 48, 64  # of the first encoder level, of every decoder level
DENSE_GROWTH = 32  # channels that a layer of a dense block adds
RESIDUAL_RATES = (1, 2, 1)  # dilation of the layers of a dilated residual dense block
PYRAMID_RATES = (1, 2, 3, 2, 1)  # of the five layers of a branch of the pyramid
PERCEPTRON_REDUCTION = 4  # of the perceptron that weighs the branches

relu_conv = partial(conv, activation=partial(nn.ReLU, inplace=True))


class ESDNet(DemoireNet):
    """An encoder and decoder of three levels; each level is a dilated residual dense block and a
    semantic-aligned scale-aware module, and each decoder level predicts the image at its scale.

    Source: section 4; the smaller of the two published networks, 5.93 million parameters. Its text
    does not give the numbers inside a level: 48 channels that double by level in the encoder, 64 in
    every decoder level, 32 a dense layer, a reduction of 4 and the dilation rates are chosen to
    give the published number of parameters. The blocks' activations are ReLU.

    `outputs` are the images at full, half and quarter size.
    """

    name = "esdnet"
    multiple = 32  # a pixel unshuffle, two levels, and a pyramid of a quarter: 2 x 4 x 4

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        wide = [scaled(ENCODER_CHANNELS * 2**level, width) for level in range(3)]
        deep, growth = scaled(DECODER_CHANNELS, width), scaled(DENSE_GROWTH, width)
        self.head = nn.Sequential(nn.PixelUnshuffle(2), *relu_conv(12, wide[0], side=5))
        self.encoders = nn.ModuleList([_level(channels, growth) for channels in wide])
        steps = itertools.pairwise(wide)
        self.downs = nn.ModuleList([relu_conv(fine, coarse, stride=2) for fine, coarse in steps])
        merged = [wide[0] + deep, wide[1] + deep, wide[2]]
        self.merges = nn.ModuleList([relu_conv(channels, deep) for channels in merged])
        self.decoders = nn.ModuleList([_level(deep, growth) for _ in wide])
        self.tails = nn.ModuleList()
        for _ in wide:
            tail = nn.Conv2d(deep, 12, 3, padding=1)
            self.tails.append(nn.Sequential(tail, nn.PixelShuffle(2)))

    def predict(self, images: Tensor) -> tuple[Tensor, ...]:
        x = self.head(images)
        skips = []
        for level, encoder in enumerate(self.encoders):
            x = encoder(x)
            skips.append(x)
            if level < 2:
                x = self.downs[level](x)
        predictions: list[Tensor] = []
        for level in (2, 1, 0):
            below = skips[level]
            if level < 2:
                below = torch.cat([below, resized(x, below)], 1)
            x = self.decoders[level](self.merges[level](below))
            predictions.insert(0, self.tails[level](x))
        return tuple(predictions)


class DenseBlock(nn.Module):
    """Dilated convolutions, each of everything before it, and a 1 x 1 convolution of them all back
    to the input's channels; after the residual dense blocks of Zhang et al. (CVPR 2018)."""

    def __init__(self, channels: int, growth: int, rates: tuple[int, ...]) -> None:
        super().__init__()
        self.layers = nn.ModuleList()
        for index, rate in enumerate(rates):
            self.layers.append(relu_conv(channels + index * growth, growth, rate=rate))
        self.fuse = nn.Conv2d(channels + len(rates) * growth, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        for layer in self.layers:
            x = torch.cat([x, layer(x)], 1)
        return self.fuse(x)


class ScaleAware(nn.Module):
    """Semantic-aligned scale-aware module (section 4.2): dense blocks of the features at full, half
    and quarter size, added to the input with weights that a perceptron finds from their means."""

    def __init__(self, channels: int, growth: int) -> None:
        super().__init__()
        branches = [DenseBlock(channels, growth, PYRAMID_RATES) for _ in range(3)]
        self.branches = nn.ModuleList(branches)
        squeezed = max(8, 3 * channels // PERCEPTRON_REDUCTION)
        self.weigh = nn.Sequential(
            *relu_conv(3 * channels, squeezed, side=1),
            *relu_conv(squeezed, squeezed, side=1),
            nn.Conv2d(squeezed, 3 * channels, 1),
            nn.Sigmoid(),
        )

    def forward(self, x: Tensor) -> Tensor:
        scales = [self.branches[0](x)]
        for scale, branch in zip((2, 4), list(self.branches)[1:], strict=True):
            small = F.interpolate(x, scale_factor=1 / scale, mode="bilinear", align_corners=False)
            scales.append(resized(branch(small), x))
        means = torch.cat(scales, 1).mean((2, 3), keepdim=True)
        weights = self.weigh(means).chunk(3, 1)
        total = x
        for weight, features in zip(weights, scales, strict=True):
            total = total + weight * features
        return total


def _level(channels: int, growth: int) -> nn.Sequential:
    residual = Residual(DenseBlock(channels, growth, RESIDUAL_RATES))
    return nn.Sequential(residual, ScaleAware(channels, growth))
