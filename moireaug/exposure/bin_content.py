"""What the photo pixels of a binned reading see of the picture."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.exposure.optics import Optics, optics_of
from moireaug.panel.fourier import emitting_share
from moireaug.scene.layout import Layout, as_layout

# variance in squared sensor pixels that a reading adds by being held over a pixel, and on a Bayer
# sensor by being interpolated: 1/2 for red and blue, 1/4 for green
HELD, INTERPOLATED = 1 / 12, 1 / 12 + 5 / 12


class Content(NamedTuple):
    """What photo pixels see of a picture, on a panel of at most one pixel per image pixel.

    Args:
        scale: (B,) its panel pixels per image pixel. ratio: (B,) of which one is so many of the
            real panel's.
        optics: of a photo pixel, in photo pixels.
        shift: (B, 3, 2) where a colour's subpixels lie from the middle of a pixel.
        width: (B, 3, 2) of a colour's subpixels, in pixels. hold: (B,) variance, in squared pixels,
            of the picture between the pixels of the finer panel.
    """

    scale: Tensor
    ratio: Tensor
    optics: Optics
    shift: Tensor
    width: Tensor
    hold: Tensor


def content_of(shot, alpha: Tensor, s: Tensor) -> Content:
    """Return the Content of a shot of `alpha` panel pixels per image pixel and `s` sensor pixels
    per photo pixel, (B,) each.

    A panel of more pixels than the picture shows it interpolated: a photo pixel then sees image
    pixels themselves, each a little wider.
    """
    ratio = alpha.clamp(min=1)
    fine = 1 - 1 / ratio  # 0 for a panel of the picture's pixels, near 1 for a much finer one
    optics = optics_of(shot)
    extra = INTERPOLATED if shot.scene.cells == "binned" else HELD
    spread = optics.blur.square() + optics.olpf.square() / 4 + optics.fill.square() / 12 + extra
    seen = Optics(
        s.clamp(min=1) / s,
        spread.sqrt() / s,
        torch.zeros_like(s),
        optics.motion_x / s,
        optics.motion_y / s,
    )
    layout = as_layout(shot.scene.panel.layout)
    cells = [colour_cell(layout, channel, shot.panel) for channel in range(3)]
    middle = [[x - 0.5, y - 0.5] for (x, y), _ in cells]
    width = torch.stack([torch.stack(sides, -1) for _, sides in cells], 1)
    return Content(
        alpha.clamp(max=1),
        ratio,
        seen,
        torch.tensor(middle, dtype=s.dtype, device=s.device) / ratio[:, None, None],
        width + (1 - width) * fine[:, None, None],
        fine / 12,
    )


def colour_cell(
    layout: Layout, channel: int, panel
) -> tuple[tuple[float, float], tuple[Tensor, Tensor]]:
    """Return where in a panel pixel a channel's light comes from, and how wide along x and y, (B,)
    each: its subpixel's, or if it has several, their middle and the whole pixel."""
    subpixels, (lit_x, lit_y) = layout.of(channel), emitting_share(panel)
    one = torch.ones_like(lit_x)
    if len(subpixels) == 1 and subpixels[0].period == (1, 1):
        (only,) = subpixels
        sides = []
        for axis in (0, 1):
            across, down = abs(only.across[axis]) * lit_x, abs(only.down[axis]) * lit_y
            sides.append(torch.maximum(across, down).clamp(max=1))
        return only.centre, (sides[0], sides[1])
    total = sum(s.density for s in subpixels) or 1.0
    x, y = (
        sum(s.density * (s.centre[axis] - s.pixel[axis] + 0.5) for s in subpixels) / total
        for axis in (0, 1)
    )
    return (float(x), float(y)) if subpixels else (0.5, 0.5), (one, one)
