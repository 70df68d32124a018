"""The picture as a panel shows it: interpolated between image pixels or, where the panel has fewer
pixels than the picture, averaged over them; and look-ups of the pixels that sensor pixels see."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.camera.exposure.bin_content import BinContent
from moireaug.common.numeric import is_transformed
from moireaug.common.tensor_physics import panel
from moireaug.scene.geometry import grids
from moireaug.scene.shot import ShotRecord
from moireaug.scene.sized import panel_scales

EDGE_PIXELS = 2  # panel pixels ahead of a picture, and behind it, until all is its edge pixels


class DisplayedPicture:
    """The light of panels that show a picture (B, 3, H, W), and its edge pixels past it.

    A panel pixel shows the mean under a triangle, along each axis, which ends one panel pixel or
    one image pixel from its centre, whichever is more. For a panel of at least the picture's
    pixels, this is bilinear interpolation.

    Args:
        content: of another panel than the shot's; see `bin_content.content_of`.
    """

    def __init__(self, light: Tensor, shot: ShotRecord, content: BinContent | None = None) -> None:
        least, most = panel_scales(shot.scene, shot.whole_size)
        alpha, self._lead = shot.panel_scale, None
        if content is not None:
            least, most, alpha = min(least, 1.0), 1.0, content.scale
            if shot.part_of is not None or shot.scene.is_crop:
                self._lead = content.lead
        if len(light) and not is_transformed():
            least, most = torch.stack(torch.aminmax(alpha.detach())).tolist()
        self.max_alpha = most  # of the finest panel
        self.alpha = alpha[:, None, None]
        self.light, self._ratio, self._ahead = light, self.alpha, 0
        if least < 1:
            # on panels of at most the picture's pixels; finer ones interpolate between these
            self.light = shrink(light, alpha.clamp(max=1), least, min(most, 1.0), self._lead)
            self._ratio, self._ahead = self.alpha.clamp(min=1), EDGE_PIXELS

    def pixels(self, image_pixels: int) -> int:
        """Return how many pixels of the finest panel show so many of the image."""
        return math.ceil(self.max_alpha * image_pixels) + (self._lead is not None)

    def look_up(self, x: Tensor, y: Tensor, channel: int | None = None) -> Tensor:
        """Return the light at panel coordinates x, y (B, h, w), of all channels or of one:
        (B, 3 or 1, h, w). Between the pixels of a coarse panel, it is interpolated."""
        light = self.light if channel is None else self.light[:, channel, None]
        return grids.look_up(light, x / self._ratio + self._ahead, y / self._ratio + self._ahead)


def shrink(
    light: Tensor,
    alpha: Tensor,
    least: float,
    most: float,
    lead: Tensor | None = None,
) -> Tensor:
    """Return a picture (B, C, H, W) as panels of alpha (B,) pixels per image pixel show it, from
    `least` to `most`, at most 1: (B, C, h, w), with `EDGE_PIXELS` panel pixels before it.

    lead: (B, 2) panel pixels along x and y, less than 1, by which the panel begins before that.
    """
    taps = math.ceil(2 / least)  # image pixels under the widest triangle
    x, y = (None, None) if lead is None else lead.unbind(1)
    fewer_rows = _shrink_rows(light, alpha, taps, most, y)
    return _shrink_rows(fewer_rows.mT, alpha, taps, most, x).mT


def _shrink_rows(
    light: Tensor, alpha: Tensor, taps: int, most: float, lead: Tensor | None
) -> Tensor:
    """Return a picture (B, C, H, W) with the rows of a panel: (B, C, h, W)."""
    _, channels, height, width = light.shape
    rows = math.ceil(most * height) + 2 * EDGE_PIXELS + (lead is not None)
    row = torch.arange(rows, dtype=alpha.dtype, device=alpha.device)
    if lead is not None:
        row = row - lead[:, None]
    ratio = alpha[:, None]
    centre, half = panel.centre_on_picture(row, EDGE_PIXELS, ratio), 1 / ratio  # in image pixels
    taps = min(taps, height)  # the rest of a triangle sees the edge pixels
    start = panel.first_under_triangle(centre, ratio).detach().clamp(0, height - taps)
    total = _triangle_before(math.inf, centre, half)
    above = _triangle_before(0, centre, half)
    below = total - _triangle_before(height, centre, half)

    def weighted(weight: Tensor, pixel: Tensor) -> Tensor:
        place = pixel.long()[:, None, :, None].expand(-1, channels, -1, width)
        return weight.to(light.dtype)[:, None, :, None] * light.gather(2, place)

    first, last = torch.zeros_like(start), torch.full_like(start, height - 1)
    out = weighted(above, first) + weighted(below, last)
    for tap in range(taps):
        pixel = start + tap
        weight = panel.triangle_weight(pixel, centre, ratio)
        out = out + weighted(weight, pixel)
    return out / total.to(light.dtype)[:, None, :, None]


def _triangle_before(end: float, centre: Tensor, half: Tensor) -> Tensor:
    """Return the sum of the weights 1 - |pixel + 1/2 - centre| / half of all pixels before `end`
    whose weights are positive, in closed form: those up to the centre rise, and the rest fall."""
    first, middle = (centre - half - 0.5).detach().ceil(), (centre - 0.5).detach().floor() + 1
    last = (centre + half - 0.5).detach().floor() + 1
    total = torch.zeros_like(centre)
    for low, high, slope in ((first, middle, 1 / half), (middle, last, -1 / half)):
        count = (high.clamp(max=end) - low).clamp(min=0)
        mean = low + count / 2  # of pixel + 1/2
        total = total + count * (1 + (mean - centre) * slope)
    return total


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
