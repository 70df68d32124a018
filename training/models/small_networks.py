"""Compact networks for small images, robust by their activation and pooling."""

import itertools

from torch import Tensor, nn


class ResidualBlock(nn.Module):
    """Pre-activation residual block: (B, inputs, H, W) to (B, outputs, H / stride, W / stride),
    rounded up.

    Source: He et al., "Identity Mappings in Deep Residual Networks" (2016), figure 1b."""

    def __init__(
        self, inputs: int, outputs: int, stride: int = 1, activation: type[nn.Module] = nn.ReLU
    ) -> None:
        super().__init__()
        self.activation = activation()
        self.norm1 = nn.BatchNorm2d(inputs)
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        same = inputs == outputs and stride == 1
        self.shortcut = None if same else nn.Conv2d(inputs, outputs, 1, stride, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        y = self.activation(self.norm1(x))
        skip = x if self.shortcut is None else self.shortcut(y)
        y = self.conv1(y)
        return skip + self.conv2(self.activation(self.norm2(y)))


class SmallResNet(nn.Module):
    """A ResNet for images of 32 to 64 px, small enough to train on a CPU. Its stem halves the
    resolution: full resolution costs most of the time and changes little.

    Args:
        width: channels of the stem; the two stages have twice and four times as many.
        activation: smooth ones, such as SiLU, make adversarial training stronger (Xie et al.,
            "Smooth Adversarial Training", 2020).
        heads: of the `AttentionPooling` before the last layer; 0 takes the plain mean.

    Takes images (B, 3, H, W), float in [0, 1], and returns logits (B, num_classes). The input is
    centred inside, so an attack in [0, 1] needs no wrapper.
    """

    def __init__(
        self,
        num_classes: int,
        width: int = 16,
        activation: type[nn.Module] = nn.ReLU,
        heads: int = 0,
    ) -> None:
        super().__init__()
        self.activation = activation()
        self.stem = nn.Conv2d(3, width, 3, 2, 1, bias=False)
        self.blocks = nn.Sequential(
            ResidualBlock(width, 2 * width, 2, activation),
            ResidualBlock(2 * width, 2 * width, 1, activation),
            ResidualBlock(2 * width, 4 * width, 2, activation),
            ResidualBlock(4 * width, 4 * width, 1, activation),
        )
        self.norm = nn.BatchNorm2d(4 * width)
        self.pool = AttentionPooling(4 * width, heads) if heads else MeanPooling()
        self.head = nn.Linear(4 * width * max(heads, 1), num_classes)

    def forward(self, images: Tensor) -> Tensor:
        x = self.blocks(self.stem((images - 0.5) * 4.0))
        return self.head(self.pool(self.activation(self.norm(x))))


class AttentionConvNet(nn.Module):
    """A plain convolutional network for images of 32 to 64 px, small enough to train on a CPU.

    Each stage pools after a convolution instead of striding over positions: photos are read better
    for the same time. The activation, SiLU, is smooth, which makes adversarial training stronger
    (Xie et al., "Smooth Adversarial Training", 2020).

    Args:
        channels: channels of the stem, which has a stride of 2, and of the stages, each of which
            halves the resolution.

    Takes images (B, 3, H, W), float in [0, 1], and returns logits (B, num_classes). The input is
    centred inside, so an attack in [0, 1] needs no wrapper.

    Source: the stages are those of K. Jordan, "94% on CIFAR-10 in 3.29 Seconds on a Single GPU"
    (2024), with normalisation and activation before each convolution.
    """

    def __init__(
        self, num_classes: int, channels: tuple[int, ...] = (48, 96, 256), heads: int = 4
    ) -> None:
        super().__init__()
        self.stem = nn.Conv2d(3, channels[0], 3, 2, 1, bias=False)
        stages = []
        for inputs, outputs in itertools.pairwise(channels):
            stages.append(_stage(inputs, outputs))
        self.stages = nn.Sequential(*stages)
        self.norm = nn.BatchNorm2d(channels[-1])
        self.activation = nn.SiLU()
        self.pool = AttentionPooling(channels[-1], heads)
        self.head = nn.Linear(channels[-1] * heads, num_classes)

    def forward(self, images: Tensor) -> Tensor:
        x = self.stages(self.stem((images - 0.5) * 4.0))
        return self.head(self.pool(self.activation(self.norm(x))))


def _stage(inputs: int, outputs: int) -> nn.Sequential:
    """Return two convolutions, with a maximum over 2 x 2 positions between them:
    (B, inputs, H, W) to (B, outputs, H / 2, W / 2), rounded up."""
    return nn.Sequential(
        nn.BatchNorm2d(inputs),
        nn.SiLU(),
        nn.Conv2d(inputs, outputs, 3, 1, 1, bias=False),
        nn.MaxPool2d(2, ceil_mode=True),
        nn.BatchNorm2d(outputs),
        nn.SiLU(),
        nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False),
    )


class MeanPooling(nn.Module):
    """The mean over all positions: (B, C, H, W) to (B, C)."""

    def forward(self, x: Tensor) -> Tensor:
        return x.mean((2, 3))


class AttentionPooling(nn.Module):
    """Means over the positions that each head attends to: (B, C, H, W) to (B, heads * C).

    A plain mean counts what an attacker paints on the background as much as the object.

    Source: Ilse et al., "Attention-based Deep Multiple Instance Learning" (2018), equation 7, with
    several heads and linear scores."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.score = nn.Conv2d(channels, heads, 1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        share = self.score(x).flatten(2).softmax(2)
        return (share @ x.flatten(2).transpose(1, 2)).flatten(1)
