"""Layers that several demoiréing networks share; all keep height and width unless they say
otherwise."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

REGION_SIDE = 8  # of the regions of non-local attention, in pixels of its scale
LEAKY_SLOPE = 0.1  # of leaky ReLUs
CHANNEL_REDUCTION = 16  # of the hidden layer of channel attention, which keeps two channels or more


def leaky() -> nn.Module:
    """Return a leaky ReLU."""
    return nn.LeakyReLU(LEAKY_SLOPE, inplace=True)


def conv(
    inputs: int,
    outputs: int,
    *,
    side: int = 3,
    stride: int = 1,
    rate: int = 1,
    activation: Callable[[], nn.Module] = leaky,
) -> nn.Sequential:
    """Return a convolution of `side` x `side` at a dilation of `rate`, and an activation; a stride
    of 2 halves the sides."""
    padding = side // 2 * rate
    layer = nn.Conv2d(inputs, outputs, side, stride=stride, padding=padding, dilation=rate)
    return nn.Sequential(layer, activation())


def resized(x: Tensor, like: Tensor) -> Tensor:
    """Resize features bilinearly to the height and width of `like`; unchanged if they match."""
    if x.shape[-2:] == like.shape[-2:]:
        return x
    return F.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)


class Residual(nn.Module):
    """A block whose input is added to its output."""

    def __init__(self, block: nn.Module) -> None:
        super().__init__()
        self.block = block

    def forward(self, x: Tensor) -> Tensor:
        return x + self.block(x)


class ChannelAttention(nn.Module):
    """Squeeze and excitation (Hu et al., CVPR 2018): channels weighed by a perceptron of their
    means."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        hidden = max(2, channels // CHANNEL_REDUCTION)
        self.weigh = nn.Sequential(
            nn.Conv2d(channels, hidden, 1),
            leaky(),
            nn.Conv2d(hidden, channels, 1),
            nn.Sigmoid(),
        )

    def forward(self, x: Tensor) -> Tensor:
        return x * self.weigh(x.mean((2, 3), keepdim=True))


class RegionAttention(nn.Module):
    """Non-local block (Wang et al., CVPR 2018, embedded Gaussian) within regions of 8 x 8 pixels
    (Dai et al., CVPR 2019), of images (B, C, H, W) whose sides are multiples of 8."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.inner = max(4, channels // 2)
        self.embed = nn.Conv2d(channels, 3 * self.inner, 1)
        self.fuse = nn.Conv2d(self.inner, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        batch, _, height, width = x.shape
        rows, columns = height // REGION_SIDE, width // REGION_SIDE
        split = self.embed(x).reshape(batch, 3, self.inner, rows, REGION_SIDE, columns, REGION_SIDE)
        query, key, value = split.permute(1, 0, 3, 5, 4, 6, 2).flatten(4, 5)
        attended = F.scaled_dot_product_attention(query, key, value)
        attended = attended.reshape(batch, rows, columns, REGION_SIDE, REGION_SIDE, self.inner)
        attended = attended.permute(0, 5, 1, 3, 2, 4).reshape(batch, self.inner, height, width)
        return x + self.fuse(attended)


class UNet(nn.Module):
    """Encoder and decoder with skip connections (Ronneberger et al., 2015), two convolutions a
    level. Sides are multiples of 2^(levels - 1), with attention of 8 times that.

    inputs, outputs: channels of the images.
    channels: of each level, the finest first; from one to the next the sides halve.
    attention: whether a `RegionAttention` follows each level of the decoder.
    """

    def __init__(
        self, inputs: int, outputs: int, channels: list[int], attention: bool = False
    ) -> None:
        super().__init__()
        self.head = nn.Sequential(conv(inputs, channels[0]), conv(channels[0], channels[0]))
        self.encoder = nn.ModuleList()
        self.decoder = nn.ModuleList()
        for fine, coarse in itertools.pairwise(channels):
            self.encoder.append(nn.Sequential(conv(fine, coarse, stride=2), conv(coarse, coarse)))
            layers: list[nn.Module] = [conv(fine + coarse, fine), conv(fine, fine)]
            if attention:
                layers.append(RegionAttention(fine))
            self.decoder.append(nn.Sequential(*layers))
        self.tail = nn.Conv2d(channels[0], outputs, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        skips = [self.head(x)]
        for level in self.encoder:
            skips.append(level(skips[-1]))
        features = skips.pop()
        for level in reversed(self.decoder):
            skip = skips.pop()
            features = level(torch.cat([skip, resized(features, skip)], 1))
        return self.tail(features)
