"""Pooling of a network's last features into one vector: a mean, or learnt attention."""

from torch import Tensor, nn


class MeanPooling(nn.Module):
    """The mean over all positions: (B, C, H, W) to (B, C)."""

    def forward(self, x: Tensor) -> Tensor:
        return x.mean((2, 3))


class AttentionPooling(nn.Module):
    """Means over the positions that each head attends to: (B, C, H, W) to (B, heads * C).

    A plain mean counts what an attacker paints on the background as much as the object.

    Source: Ilse et al., "Attention-based Deep Multiple Instance Learning" (2018), equation 7, with
    several heads and linear scores.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.score = nn.Conv2d(channels, heads, 1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        share = self.score(x).flatten(2).softmax(2)
        return (share @ x.flatten(2).transpose(1, 2)).flatten(1)
