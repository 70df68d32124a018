"""Networks that change as they are used: what attacks and evaluations must put back."""

import torch
from torch import nn


class LowRank(nn.Linear):
    """A linear layer that merges a low-rank weight in evaluation, and unmerges it in training."""

    def __init__(self, inputs, outputs):
        super().__init__(inputs, outputs)
        self.weight.requires_grad_(False)
        self.bias.requires_grad_(False)
        self.down = nn.Parameter(torch.randn(2, inputs))
        self.up = nn.Parameter(torch.randn(outputs, 2))
        self.merged = False

    def train(self, mode=True):
        super().train(mode)
        if self.merged == mode:
            sign = -1 if mode else 1
            self.weight.data += sign * (self.up @ self.down)
            self.merged = not mode
        return self

    def forward(self, x):
        y = super().forward(x)
        return y if self.merged else y + x @ self.down.T @ self.up.T


class Observer(nn.Module):
    """Writes into its buffers in evaluation, too, in every way that quantisation's observers,
    queues and counters do; `calls` is a caller's own count."""

    def __init__(self):
        super().__init__()
        self.register_buffer("range", torch.zeros(2))
        self.register_buffer("channels", torch.zeros(0))
        self.register_buffer("queue", torch.zeros(4, 2))
        self.register_buffer("count", torch.tensor(0))
        self.register_buffer("last", None)
        self.is_ready, self.calls = False, 0

    def forward(self, x):
        seen = x.detach()
        self.calls += 1
        if not self.is_ready:
            self.range = torch.stack([seen.min(), seen.max()])  # another tensor
            self.is_ready = True
        self.channels.resize_(x.shape[1]).copy_(seen.amax(0))
        self.queue[:1] = seen[0, :2]
        self.count.data += 1  # behind the version counter
        self.last = seen.mean()
        return x


class Counter(nn.Module):
    """Counts its calls, as those who compare query budgets do."""

    calls = 0

    def forward(self, x):
        self.calls += 1
        return x


def network():
    torch.manual_seed(0)
    layers = (nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.AdaptiveAvgPool2d(4), nn.Flatten())
    return nn.Sequential(*layers, LowRank(64, 5), Observer())
