"""The picture as a panel shows it: interpolated between image pixels or, where the panel has fewer
pixels than the picture, averaged over them."""

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
