"""MopNet (He et al., "Mop Moiré Patterns Using MopNet", ICCV 2019)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from moireaug.defenses.demoire.base import DemoireNet, scaled
from moireaug.defenses.demoire.layers import REGION_SIDE, ChannelAttention, UNet, conv, resized

DENSE_CHANNELS, DENSE_GROWTH, DENSE_LAYERS, DENSE_SCALES = 80, 52, 6, 5  # of the generator
BOTTLENECK_FACTOR = 4  # channels of a dense layer's bottleneck, as a multiple of its growth
EDGE_CHANNELS = (60, 120, 240, 480)  # channels of the levels of the edge predictor
N_ATTRIBUTES = 3  # colour; frequency and shape
HEAD_UNITS, HEAD_GRID = 256, 3  # of a classifier's head: units, and side of its input map
MAX_SOBEL_SUM = 4.0  # the largest sum of a Sobel kernel over values in [0, 1]


class MopNet(DemoireNet):
    """A multi-scale densely connected generator that is told the edges of the clean image, by an
    edge predictor, and the moiré's attributes, by classifiers.

    Source: features of dense blocks at several scales, brought to full size by convolutions,
    concatenated and weighed by squeeze and excitation (multi-scale aggregation); an encoder and
    decoder with non-local blocks from the photo, its Sobel edges added channel by channel, to the
    edges of the clean image; networks like VGG-16 for whether the moiré has one or several colours,
    a low or a high frequency, and straight or curved stripes, whose answers go into the last layers
    as constant maps. The paper's layer counts were not available. Chosen here: five scales, six
    dense layers each of growth 52, no batch normalisation, the channels of the edge predictor,
    non-local blocks within regions, and the classifiers' heads. They give 5.54 (generator), 6.99
    (edges), 15.9 (colour) and 31.8 (frequency and shape) million parameters where 5.45, 6.95, 15.9
    and 31.9 are published. The paper trains the classifiers on photos labelled by hand; here they
    are trained with the rest, by the image's loss alone.

    `outputs` are the image and the edges of the clean image, as `sobel` computes them.
    """

    name = "mopnet"
    multiple = 2 ** (len(EDGE_CHANNELS) - 1) * REGION_SIDE

    def __init__(self, width: float = 1.0) -> None:
        super().__init__(width)
        channels, growth = scaled(DENSE_CHANNELS, width), scaled(DENSE_GROWTH, width)
        self.edges = UNet(3, 3, [scaled(level, width) for level in EDGE_CHANNELS], attention=True)
        self.colour = Classifier(width)
        self.stripes = nn.ModuleList([Classifier(width) for _ in range(N_ATTRIBUTES - 1)])
        self.image_head = conv(3, channels)
        self.edge_head = conv(3, channels)
        self.merge = conv(2 * channels, channels)
        self.scales = nn.ModuleList([DenseScale(channels, growth) for _ in range(DENSE_SCALES)])
        self.aggregate = ChannelAttention(DENSE_SCALES * channels)
        self.tail = nn.Sequential(
            ChannelAttention(DENSE_SCALES * channels + N_ATTRIBUTES),
            conv(DENSE_SCALES * channels + N_ATTRIBUTES, 2 * channels),
            conv(2 * channels, channels),
            nn.Conv2d(channels, 3, 3, padding=1),
        )

    def predict(self, images: Tensor) -> tuple[Tensor, ...]:
        edges = self.edges(images + sobel(images))
        x = self.merge(torch.cat([self.image_head(images), self.edge_head(edges)], 1))
        scales = []
        for level, scale in enumerate(self.scales):
            if level:
                x = F.avg_pool2d(x, 2)
            x, full = scale(x, images)
            scales.append(full)
        features = self.aggregate(torch.cat(scales, 1))
        answers = [classifier(images) for classifier in (self.colour, *self.stripes)]
        maps = torch.cat(answers, 1).sigmoid()[..., None, None]
        maps = maps.expand(-1, -1, *images.shape[-2:])
        return images + self.tail(torch.cat([features, maps], 1)), edges


class DenseScale(nn.Module):
    """A dense block with bottlenecks (Huang et al., CVPR 2017) at one scale, and its features at
    full size."""

    def __init__(self, channels: int, growth: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList()
        for index in range(DENSE_LAYERS):
            neck = nn.Conv2d(channels + index * growth, BOTTLENECK_FACTOR * growth, 1)
            layer = conv(BOTTLENECK_FACTOR * growth, growth)
            self.layers.append(nn.Sequential(neck, nn.ReLU(), layer))
        self.shrink = nn.Conv2d(channels + DENSE_LAYERS * growth, channels, 1)
        self.upsample = conv(channels, channels)

    def forward(self, x: Tensor, full: Tensor) -> tuple[Tensor, Tensor]:
        for layer in self.layers:
            x = torch.cat([x, layer(x)], 1)
        x = self.shrink(x)
        return x, resized(self.upsample(x), full)


class Classifier(nn.Module):
    """VGG-16's convolutions and a head of one logit: (B, 3, H, W) to (B, 1)."""

    def __init__(self, width: float) -> None:
        from torchvision.models import vgg  # takes seconds to import

        super().__init__()
        vgg16 = vgg.cfgs["D"]
        layers = [layer if layer == "M" else scaled(int(layer), width) for layer in vgg16]
        self.features = vgg.make_layers(layers)
        inputs = HEAD_GRID**2 * int(layers[-2])
        hidden = scaled(HEAD_UNITS, width)
        self.head = nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, 1))
        for layer in self.features:
            if isinstance(layer, nn.Conv2d):  # torch's default start loses the signal
                nn.init.kaiming_normal_(layer.weight, mode="fan_out", nonlinearity="relu")
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)

    def forward(self, images: Tensor) -> Tensor:
        features = F.adaptive_avg_pool2d(self.features(images - 0.5), HEAD_GRID)
        return self.head(features.flatten(1))


def sobel(images: Tensor) -> Tensor:
    """Compute the strength of the edges of each channel, (B, 3, H, W) to the same shape in [0,
    sqrt(2)]: the length of Sobel's gradient, 1 for an upright step from 0 to 1."""
    across = images.new_tensor([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]]) / MAX_SOBEL_SUM
    kernels = torch.stack([across, across.T]).repeat(3, 1, 1)[:, None]
    framed = F.pad(images, (1, 1, 1, 1), mode="replicate")
    parts = F.conv2d(framed, kernels, groups=3).unflatten(1, (3, 2))
    return (parts.square().sum(2) + 1e-8).sqrt() - 1e-4  # no kink where the image is flat
