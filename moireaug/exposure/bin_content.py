"""What the photo pixels of a binned reading see of the picture."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from moireaug.exposure import footprints
from moireaug.exposure.footprints import Footprint
from moireaug.exposure.optics import Optics, optics_of
from moireaug.panel.fourier import emitting_share
from moireaug.scene.fields import bounds
from moireaug.scene.layout import Layout, as_layout
from moireaug.scene.record import SceneRecord
from moireaug.scene.subpixel import Subpixel
from moireaug.shot import ShotRecord

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
            sides: (B, ..., 2, 2) of the bins, see `bin_geometry.Bins`.
        """
        along = step[..., axis, :]
        zero, one = torch.zeros_like(self.hold), torch.ones_like(self.hold)
        across_bin = (along[..., None] * sides).sum(-2)
        box = footprints.footprint(across_bin, Optics(one, zero, zero, zero, zero))
        return Footprint(box.box, box.variance + footprints.blur_variance(along, self.optics))


def content_of(shot: ShotRecord) -> Content:
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
    middle, edges, whole = map(alpha.new_tensor, _colour_cells(layout))
    lit_x, lit_y = (share[:, None, None] for share in emitting_share(shot.panel))
    # the larger of its two edges, one across and one down
    width = torch.maximum(edges[..., 0] * lit_x, edges[..., 1] * lit_y).clamp(max=1)
    width = torch.where(whole > 0, torch.ones_like(width), width)
    return Content(
        alpha.clamp(max=1),
        ratio,
        gaussian_optics(shot.scene, optics_of(shot)),
        middle / ratio[:, None, None],
        width + (1 - width) * fine[:, None, None],
        hold,
    )


def gaussian_optics(scene: SceneRecord, optics: Optics) -> Optics:
    """Return the optics of a sensor pixel with its aperture, and what holding and interpolation add
    to it, as a Gaussian."""
    extra = BAYER_HOLD_VARIANCE if scene.cells == "binned" else HOLD_VARIANCE
    variance = optics.blur.square() + optics.fill.square() / 12 + extra
    return optics._replace(fill=torch.zeros_like(optics.fill), blur=variance.sqrt())


@functools.lru_cache(maxsize=64)
def _colour_cells(layout: Layout) -> tuple[list, list, list]:
    """Return where in a panel pixel each channel's light comes from: its subpixel, or if it has
    several, their middle and the whole pixel.

    Returns:
        (3, 2) the middle along x and y, from that of the pixel; (3, 2, 2) the lengths along x and y
        of the subpixel's two edges; and (3, 1) whether it is the whole pixel.
    """
    middles, edges, whole = [], [], []
    for channel in range(3):
        subpixels = layout.of(channel)
        single = len(subpixels) == 1 and subpixels[0].period == (1, 1)
        middles.append(subpixels[0].centre if single else _mean_place(subpixels))
        across, down = (subpixels[0].across, subpixels[0].down) if single else ((1, 0), (0, 1))
        edges.append([[abs(across[axis]), abs(down[axis])] for axis in (0, 1)])
        whole.append([not single])
    return [[x - 0.5, y - 0.5] for x, y in middles], edges, whole


def _mean_place(subpixels: Sequence[Subpixel]) -> tuple[float, float]:
    """Return the mean place of some subpixels in their panel pixels, weighted by their area."""
    if not subpixels:
        return 0.5, 0.5
    total = sum(s.density for s in subpixels)
    x, y = (
        sum(s.density * (s.centre[axis] - s.pixel[axis] + 0.5) for s in subpixels) / total
        for axis in (0, 1)
    )
    return x, y
