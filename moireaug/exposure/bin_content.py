"""What the photo pixels of a binned reading see of the picture."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.exposure import content
from moireaug.exposure.content import Footprint
from moireaug.exposure.optics import Optics, optics_of
from moireaug.panel.fourier import emitting_share
from moireaug.scene.fields import bounds
from moireaug.scene.layout import Layout, as_layout
from moireaug.scene.record import SceneRecord

# variance in squared sensor pixels that a reading adds by being held over a pixel, and on a Bayer
# sensor by being interpolated: 5/12 is the mean of 1/2 for red and blue, and 1/4 for green
HOLD_VARIANCE, BAYER_HOLD_VARIANCE = 1 / 12, 1 / 12 + 5 / 12


class Content(NamedTuple):
    """What bins see of a picture, on a panel of at most one pixel per image pixel.

    Args:
        scale: (B,) its panel pixels per image pixel.
        ratio: (B,) real panel pixels per pixel of this coarser panel.
        optics: of a sensor pixel, its aperture as a Gaussian.
        shift: (B, 3, 2) where a colour's subpixels lie from the middle of a pixel.
        width: (B, 3, 2) of a colour's subpixels, in pixels.
        hold: (B,) variance that interpolating the picture adds, in squared pixels.
    """

    scale: Tensor
    ratio: Tensor
    optics: Optics
    shift: Tensor
    width: Tensor
    hold: Tensor

    def footprint(self, axis: int, step: Tensor, sides: Tensor) -> Footprint:
        """Return what bins see along x (axis 0) or y (axis 1), without `hold`: (B, ...) each, in
        pixels.

        Args:
            step: (B, ..., 2, 2), change in pixels per sensor pixel along u and v.
            sides: (B, ..., 2, 2) of the bins, see `bins.Bins`.
        """
        along = step[..., axis, :]
        zero, one = torch.zeros_like(self.hold), torch.ones_like(self.hold)
        across_bin = (along[..., None] * sides).sum(-2)
        box = content.footprint(across_bin, Optics(one, zero, zero, zero, zero))
        return Footprint(box.box, box.variance + content.blur_variance(along, self.optics))


def content_of(shot) -> Content:
    """Return the Content of a shot.

    A panel of more pixels than the picture shows more than the picture holds: with `Panel.width`,
    whatever has the picture's pixels as its means; with `Panel.scale`, the picture itself,
    interpolated. A bin then sees image pixels, in the latter case each a little wider.
    """
    alpha, layout = shot.panel_scale, as_layout(shot.scene.panel.layout)
    ratio = alpha.clamp(min=1)
    fine = 1 - 1 / ratio  # 0 for a panel of the picture's pixels, near 1 for a much finer one
    hold = torch.zeros_like(fine)
    if not bounds(shot.scene.panel.width)[1]:
        # the filter that shrinks the photo blurs the picture, too, where its pixels are not means
        second_mean = 1.0 if shot.scene.develop.resize == "antialias" else 0.0
        hold = (fine + second_mean * alpha.clamp(max=1).square()) / 12
    cells = [colour_cell(layout, channel, shot.panel) for channel in range(3)]
    middle = alpha.new_tensor([[x - 0.5, y - 0.5] for (x, y), _ in cells])
    width = torch.stack([torch.stack(sides, -1) for _, sides in cells], 1)
    return Content(
        alpha.clamp(max=1),
        ratio,
        spread_of(shot.scene, optics_of(shot)),
        middle / ratio[:, None, None],
        width + (1 - width) * fine[:, None, None],
        hold,
    )


def spread_of(scene: SceneRecord, optics: Optics) -> Optics:
    """Return the optics of a sensor pixel with its aperture, and what holding and interpolation add
    to it, as a Gaussian."""
    extra = BAYER_HOLD_VARIANCE if scene.cells == "binned" else HOLD_VARIANCE
    variance = optics.blur.square() + optics.fill.square() / 12 + extra
    return optics._replace(fill=torch.zeros_like(optics.fill), blur=variance.sqrt())


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
