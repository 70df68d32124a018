"""A compact convolutional network for small images, robust by its activation and pooling."""

import itertools

from torch import Tensor, nn

from training.models.pooling import AttentionPooling

# of the stem, which has a stride of 2, and of the stages, each of which halves the resolution
CHANNELS = (48, 96, 256)
HEADS = 4  # of the pooling


class AttentionConvNet(nn.Module):
    """A plain convolutional network for images of 32 to 64 px, small enough to train on a CPU.

    Each stage pools after a convolution instead of striding over positions: photos are read better
    for the same time. The activation, SiLU, is smooth, which makes adversarial training stronger
    (Xie et al., "Smooth Adversarial Training", 2020).

    Args:
        num_classes: number of logits.

    Takes images (B, 3, H, W), float in [0, 1], and returns logits (B, num_classes). The input is
    centred inside, so an attack in [0, 1] needs no wrapper.

    Source: the stages are those of K. Jordan, "94% on CIFAR-10 in 3.29 Seconds on a Single GPU"
    (2024), with normalisation and activation before each convolution.
    """

    def __init__(self, num_classes: int) -> None:
        super().__init__()
        self.stem = nn.Conv2d(3, CHANNELS[0], 3, 2, 1, bias=False)
        self.stages = nn.Sequential(*itertools.starmap(_stage, itertools.pairwise(CHANNELS)))
        self.norm = nn.BatchNorm2d(CHANNELS[-1])
        self.activation = nn.SiLU()
        self.pool = AttentionPooling(CHANNELS[-1], HEADS)
        self.head = nn.Linear(CHANNELS[-1] * HEADS, num_classes)

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
