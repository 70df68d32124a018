"""The picture on the panel's pixels, and look-ups of the pixels that sensor pixels see."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.camera.exposure.bin_content import BinContent
from moireaug.camera.exposure.displayed import DisplayedPicture
from moireaug.scene.shot import ShotRecord


class Screen:
    """The pixels of the panel: they show the picture (B, 3, H, W) at their centres, and its edge
    pixels past it.

    The picture is put on the panel once, unless the panel has more pixels than are looked up.
    """

    def __init__(
        self, light: Tensor, shot: ShotRecord, taps: int, content: BinContent | None = None
    ) -> None:
        """`content` describes another panel than the shot's, of at most a pixel per image pixel,
        whose cells are single pixels."""
        self.light, self.taps = light, taps
        self.picture = DisplayedPicture(light, shot, content)
        self.alpha = self.picture.alpha
        px, py = shot.scene.panel.cell.period if content is None else (1, 1)
        # far enough past the picture for all taps to show its edge pixels
        self.margin = (taps * py, taps * px)
        height, width = shot.size
        self.size = (
            self.picture.pixels(height) + 2 * taps * py,
            self.picture.pixels(width) + 2 * taps * px,
        )
        self.panel = None
        readings = math.prod(shot.raw_shape()[-2:])
        if math.prod(self.size) <= taps**2 * readings:
            self.panel = on_panel(self.picture, self.size, self.margin).flatten(2).unbind(1)

    def look(self, channel: int, column: Tensor, row: Tensor, period: tuple[int, int]) -> Tensor:
        """Return the light of panel pixels from (B, h, w) columns and rows on, one per period,
        `taps` downwards and to the right: (taps, taps, B, h, w)."""
        if self.panel is None:
            return self._on_picture(channel, column, row, period)
        px, py = period
        (h, w), (above, before) = self.size, self.margin
        first = (row + above).clamp(0, h - above) * w + (column + before).clamp(0, w - before)
        tap = torch.arange(self.taps, device=first.device)
        steps = (tap[:, None] * (py * w) + tap * px).flatten()
        # torch.compile does not follow a derivative of our own
        gather = Gather.forward if torch.compiler.is_compiling() else Gather.apply
        found = gather(self.panel[channel], first.long().flatten(1), steps)
        return found.reshape(self.taps, self.taps, *row.shape)

    def _on_picture(
        self, channel: int, column: Tensor, row: Tensor, period: tuple[int, int]
    ) -> Tensor:
        """Look up panel pixels in the picture itself; arguments and result as in `look`."""
        tap = torch.arange(self.taps, dtype=row.dtype, device=row.device)[:, None, None, None]
        x, y = column + (tap * period[0] + 0.5), row + (tap * period[1] + 0.5)
        # one look-up for all taps, as rows of one picture: (B, taps * taps * h, w)
        x, y = (t.movedim(2, 0).flatten(1, 3) for t in torch.broadcast_tensors(x, y[:, None]))
        found = self.picture.look_up(x, y, channel)[:, 0]
        return found.unflatten(1, (self.taps, self.taps, -1)).movedim(0, 2)


class Gather(torch.autograd.Function):
    """Gather numbers (B, N) at indices (B, P) plus each of some steps (S,): (S, B, P).
    Differentiable any number of times, forward, too.

    torch.gather would keep an index for each step for its gradient.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(numbers: Tensor, first: Tensor, steps: Tensor) -> Tensor:
        return numbers.expand(len(steps), -1, -1).gather(2, first + steps[:, None, None])

    @staticmethod
    def setup_context(ctx, inputs: tuple, output: Tensor) -> None:
        numbers, first, steps = inputs
        ctx.save_for_backward(first, steps)
        ctx.save_for_forward(first, steps)
        ctx.n = numbers.shape[1]
        ctx.set_materialize_grads(False)  # no gradient is not one of zeros

    @staticmethod
    def backward(ctx, slopes: Tensor | None) -> tuple:
        if slopes is None:
            return None, None, None
        first, steps = ctx.saved_tensors
        index = (first + steps[:, None, None]).movedim(0, 1).flatten(1)
        nothing = slopes.new_zeros(len(first), ctx.n)
        return nothing.scatter_add(1, index, slopes.movedim(0, 1).flatten(1)), None, None

    @staticmethod
    def jvp(ctx, along: Tensor, *_: None) -> Tensor:
        first, steps = ctx.saved_tensors
        return along.expand(len(steps), -1, -1).gather(2, first + steps[:, None, None])


def on_panel(picture: DisplayedPicture, size: tuple[int, int], margin: tuple[int, int]) -> Tensor:
    """Return the light of a panel's pixels, (B, 3, h, w), from a margin before the picture on."""
    (height, width), (above, before) = size, margin
    device = picture.light.device
    y = torch.arange(height, dtype=torch.float64, device=device) + (0.5 - above)
    x = torch.arange(width, dtype=torch.float64, device=device) + (0.5 - before)
    return picture.look_up(*torch.broadcast_tensors(x[None, None], y[None, :, None]))
