"""A compact ResNet for small images, plain or with a robust activation and pooling."""

from torch import Tensor, nn

from training.models.pooling import AttentionPooling, MeanPooling


class ResidualBlock(nn.Module):
    """Pre-activation residual block: (B, inputs, H, W) to (B, outputs, H / stride, W / stride),
    rounded up.

    Source: He et al., "Identity Mappings in Deep Residual Networks" (2016), figure 1b.
    """

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
        num_classes: number of logits.
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
