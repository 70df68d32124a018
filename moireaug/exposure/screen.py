"""The picture on the panel's pixels, and the look-ups of those that sensor pixels see."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.geometry import grids
from moireaug.scene.fields import bounds
from moireaug.scene.layout import as_layout

LOOKS = 1  # panel pixels, for each that is looked at, up to which a panel is built


class Screen:
    """What the panel's pixels show: the picture (B, 3, H, W) at their centres, and its border past it.

    The picture is put on the panel once, unless the panel has more pixels than are looked at.
    """

    def __init__(self, light: Tensor, shot, taps: int) -> None:
        self.light, self.taps, self.alpha = light, taps, shot.panel.scale[:, None, None]
        most = bounds(shot.scene.panel.scale)[1]
        if len(light) and not torch.compiler.is_compiling():
            most = float(self.alpha.detach().max())
        period = as_layout(shot.scene.panel.layout).period
        # far enough past the picture for all taps to be on its border
        self.margin = [taps * period[axis] for axis in (1, 0)]
        self.size = [math.ceil(most * n) + 2 * margin for n, margin in zip(shot.size, self.margin, strict=True)]
        self.panel = None
        if math.prod(self.size) <= LOOKS * taps**2 * math.prod(shot.raw_shape()[-2:]):
            self.panel = on_panel(light, self.size, self.margin, self.alpha).flatten(2).unbind(1)

    def look(self, channel: int, column: Tensor, row: Tensor, period: tuple[int, int]) -> list[list[Tensor]]:
        """Return what panel pixels show from (B, h, w) columns and rows on, one a period: `taps` lists, downwards, of
        `taps` tensors (B, h, w), to the right."""
        (px, py), n = period, self.taps
        if self.panel is None:
            plane, alpha = self.light[:, channel, None], self.alpha
            x = [(column + (i * px + 0.5)) / alpha for i in range(n)]
            y = [(row + (j * py + 0.5)) / alpha for j in range(n)]
            return [[grids.look_up(plane, x[i], y[j])[:, 0] for i in range(n)] for j in range(n)]
        (h, w), (above, before) = self.size, self.margin
        first = (row + above).clamp(0, h - above) * w + (column + before).clamp(0, w - before)
        steps = [j * py * w + i * px for j in range(n) for i in range(n)]
        found = Gather.apply(self.panel[channel], first.long().flatten(1), steps)
        return [[found[j * n + i].reshape(row.shape) for i in range(n)] for j in range(n)]


class Gather(torch.autograd.Function):
    """Numbers (B, N) at indices (B, P) plus each of some steps: (B, P) each. Differentiable any number of times.

    For its gradient torch.gather would keep an index for each step.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(numbers: Tensor, first: Tensor, steps: list[int]) -> tuple[Tensor, ...]:
        return tuple(numbers[:, step:].gather(1, first) for step in steps)

    @staticmethod
    def setup_context(ctx, inputs: tuple, output: tuple) -> None:
        numbers, first, ctx.steps = inputs
        ctx.save_for_backward(first)
        ctx.n = numbers.shape[1]

    @staticmethod
    def backward(ctx, *slopes: Tensor) -> tuple:
        (first,) = ctx.saved_tensors
        index = torch.cat([first + step for step in ctx.steps], 1)
        nothing = slopes[0].new_zeros(len(first), ctx.n)
        return nothing.scatter_add(1, index, torch.cat(slopes, 1)), None, None


def on_panel(light: Tensor, size: list[int], margin: list[int], alpha: Tensor) -> Tensor:
    """Return what the panel's pixels show of a picture (B, 3, H, W): its values at their centres, (B, 3, h, w), from a
    margin before the picture, which has its border."""
    y, x = (
        torch.arange(n, dtype=alpha.dtype, device=alpha.device) + (0.5 - before)
        for n, before in zip(size, margin, strict=True)
    )
    x, y = torch.broadcast_tensors(x / alpha, y[:, None] / alpha)
    return grids.look_up(light, x, y)
