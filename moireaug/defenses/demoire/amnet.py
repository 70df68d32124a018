"""AMNet (Yue et al., "Recaptured Screen Image Demoiréing", IEEE TCSVT 2021), the generator."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from moireaug.defenses.demoire.base import DemoireNet, scaled
from moireaug.defenses.demoire.layers import conv

ADDITIVE_CHANNELS = (32, 64, 108)  # of the additive module, the finest first
PYRAMID_RATES = (1, 2, 4, 8)  # dilation of the pyramid's branches
FACTOR_CHANNELS, FACTOR_BLOCKS = 36, 4  # channels and blocks of the multiplicative module


class AMNet(DemoireNet):
    """An additive module takes the moiré away, a multiplicative module brings the brightness back:
    output = (photo + additive) x multiplicative.

    Source: the two modules, the atrous spatial pyramid (ASPP) and the nearest-neighbour upsampling
    (figure of the architecture); the generator alone. The paper's layer counts were not available:
    chosen here, to agree with the published 1.41 million parameters, are an encoder and decoder of
    three levels around one pyramid of four rates, and four multiplicative blocks at quarter size,
    each of two convolutions whose product with a sigmoid of a third goes on.
    """

    name = "amnet"
    multiple = 4

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        fine, middle, coarse = [scaled(channels, width) for channels in ADDITIVE_CHANNELS]
        self.head = nn.Sequential(conv(3, fine), conv(fine, fine))
        self.down = nn.Sequential(conv(fine, middle, stride=2), conv(middle, middle))
        self.deep = nn.Sequential(conv(middle, coarse, stride=2), conv(coarse, coarse))
        self.pyramid = Pyramid(coarse)
        self.twice = nn.Upsample(scale_factor=2, mode="nearest")
        self.up = nn.Sequential(conv(coarse + middle, middle), conv(middle, middle))
        self.top = nn.Sequential(conv(middle + fine, fine), conv(fine, fine))
        self.additive = nn.Conv2d(fine, 3, 3, padding=1)
        factors = scaled(FACTOR_CHANNELS, width)
        blocks = [Multiplicative(factors) for _ in range(FACTOR_BLOCKS)]
        shrink = [conv(3, factors, stride=2), conv(factors, factors, stride=2)]
        self.brightness = nn.Sequential(*shrink, *blocks)
        self.spread = nn.Sequential(self.twice, conv(factors, factors), self.twice)
        self.multiplicative = nn.Conv2d(factors, 3, 3, padding=1)

    def predict(self, images: Tensor) -> tuple[Tensor, ...]:
        fine = self.head(images)
        middle = self.down(fine)
        features = self.pyramid(self.deep(middle))
        features = self.up(torch.cat([middle, self.twice(features)], 1))
        features = self.top(torch.cat([fine, self.twice(features)], 1))
        cleaned = images + self.additive(features)
        factors = 1 + self.multiplicative(self.spread(self.brightness(images)))
        return (cleaned * factors,)


class Pyramid(nn.Module):
    """Atrous spatial pyramid pooling (Chen et al., 2017): dilated convolutions side by side, and
    one of all of them."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        branches = [conv(channels, channels, rate=rate) for rate in PYRAMID_RATES]
        self.branches = nn.ModuleList(branches)
        self.fuse = conv(len(PYRAMID_RATES) * channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.fuse(torch.cat([branch(x) for branch in self.branches], 1))


class Multiplicative(nn.Module):
    """Features times a sigmoid of others."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(conv(channels, channels), conv(channels, channels))
        self.gate = nn.Sequential(nn.Conv2d(channels, channels, 3, padding=1), nn.Sigmoid())

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x) * self.gate(x)
