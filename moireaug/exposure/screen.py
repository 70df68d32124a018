"""The picture on the panel's pixels, and look-ups of the pixels that sensor pixels see."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.geometry import grids
from moireaug.numeric import is_transformed
from moireaug.scene.fields import bounds
from moireaug.scene.layout import as_layout

LOOKS = 1  # the panel is built if it has at most this many pixels per look-up


class Screen:
    """What the panel's pixels show: the picture (B, 3, H, W) at their centres, and its edge pixels
    past it.

    The picture is put on the panel once, unless the panel has more pixels than are looked up.
    """

    def __init__(self, light: Tensor, shot, taps: int) -> None:
        self.light, self.taps, self.alpha = light, taps, shot.panel.scale[:, None, None]
        most = bounds(shot.scene.panel.scale)[1]
        if len(light) and not is_transformed():
            most = float(self.alpha.detach().max())
        px, py = as_layout(shot.scene.panel.layout).period
        # far enough past the picture for all taps to show its edge pixels
        self.margin = (taps * py, taps * px)
        height, width = shot.size
        self.size = (
            math.ceil(most * height) + 2 * taps * py,
            math.ceil(most * width) + 2 * taps * px,
        )
        self.panel = None
        readings = math.prod(shot.raw_shape()[-2:])
        if math.prod(self.size) <= LOOKS * taps**2 * readings:
            self.panel = on_panel(light, self.size, self.margin, self.alpha).flatten(2).unbind(1)

    def look(
        self, channel: int, column: Tensor, row: Tensor, period: tuple[int, int]
    ) -> list[list[Tensor]]:
        """Return what panel pixels show from (B, h, w) columns and rows on, one per period: `taps`
        lists downwards, of `taps` tensors (B, h, w) to the right."""
        if self.panel is None:
            return self._on_picture(channel, column, row, period)
        px, py = period
        (h, w), (above, before) = self.size, self.margin
        first = (row + above).clamp(0, h - above) * w + (column + before).clamp(0, w - before)
        steps = []
        for j in range(self.taps):
            for i in range(self.taps):
                steps.append(j * py * w + i * px)
        found = Gather.apply(self.panel[channel], first.long().flatten(1), steps)
        shown = []
        for j in range(self.taps):
            line = found[j * self.taps : (j + 1) * self.taps]
            shown.append([values.reshape(row.shape) for values in line])
        return shown

    def _on_picture(
        self, channel: int, column: Tensor, row: Tensor, period: tuple[int, int]
    ) -> list[list[Tensor]]:
        """Look up panel pixels in the picture itself; arguments and result as in `look`."""
        px, py = period
        picture = self.light[:, channel, None]
        shown = []
        for j in range(self.taps):
            y = (row + (j * py + 0.5)) / self.alpha
            line = []
            for i in range(self.taps):
                x = (column + (i * px + 0.5)) / self.alpha
                line.append(grids.look_up(picture, x, y)[:, 0])
            shown.append(line)
        return shown


class Gather(torch.autograd.Function):
    """Gather numbers (B, N) at indices (B, P) plus each of some steps: (B, P) each. Differentiable
    any number of times, forward, too.

    torch.gather would keep an index for each step for its gradient.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(numbers: Tensor, first: Tensor, steps: list[int]) -> tuple[Tensor, ...]:
        return tuple(numbers[:, step:].gather(1, first) for step in steps)

    @staticmethod
    def setup_context(ctx, inputs: tuple, output: tuple) -> None:
        numbers, first, ctx.steps = inputs
        ctx.save_for_backward(first)
        ctx.save_for_forward(first)
        ctx.n = numbers.shape[1]

    @staticmethod
    def backward(ctx, *slopes: Tensor) -> tuple:
        (first,) = ctx.saved_tensors
        index = torch.cat([first + step for step in ctx.steps], 1)
        nothing = slopes[0].new_zeros(len(first), ctx.n)
        return nothing.scatter_add(1, index, torch.cat(slopes, 1)), None, None

    @staticmethod
    def jvp(ctx, along: Tensor, *_: None) -> tuple[Tensor, ...]:
        (first,) = ctx.saved_tensors
        return tuple(along[:, step:].gather(1, first) for step in ctx.steps)


def on_panel(
    light: Tensor, size: tuple[int, int], margin: tuple[int, int], alpha: Tensor
) -> Tensor:
    """Return what the panel's pixels show of a picture (B, 3, H, W): its values at their centres,
    (B, 3, h, w), starting a margin before the picture, where its edge pixels are repeated."""
    (height, width), (above, before) = size, margin
    y = torch.arange(height, dtype=alpha.dtype, device=alpha.device) + (0.5 - above)
    x = torch.arange(width, dtype=alpha.dtype, device=alpha.device) + (0.5 - before)
    x, y = torch.broadcast_tensors(x / alpha, y[:, None] / alpha)
    return grids.look_up(light, x, y)
