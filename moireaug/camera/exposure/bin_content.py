"""The picture as the photo pixels of a binned reading see it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from moireaug.camera.exposure.bin_geometry import Bins
from moireaug.camera.exposure.footprint import Footprint, Optics, blur_variance, optics_of
from moireaug.camera.panel import emitting_share
from moireaug.common.numeric import array_like, library_of
from moireaug.scene.layout import Layout
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot_geometry import ShotGeometry
from moireaug.scene.subpixel import Subpixel

# variance in squared sensor pixels that a reading adds by being held over a pixel, and on a Bayer
# sensor by being interpolated: 5/12 is the mean of 1/2 for red and blue, and 1/4 for green
HOLD_VARIANCE, BAYER_HOLD_VARIANCE = 1 / 12, 1 / 12 + 5 / 12


class BinContent(NamedTuple):
    """The picture as bins see it, on a panel of at most one pixel per image pixel; tensors or
    arrays.

    Args:
        scale: (B,) its panel pixels per image pixel.
        ratio: (B,) real panel pixels per pixel of this coarser panel.
        optics: of a sensor pixel, its aperture as a Gaussian.
        shift: (B, 3, 2) where a colour's subpixels lie from the middle of a pixel.
        width: (B, 3, 2) of a colour's subpixels, in pixels.
        interpolation_variance: (B,) added by interpolating the picture, in squared pixels.
        lead: (B, 2) pixels along x and y from the coarser panel's corner to the picture's: of the
            panel pixels that a part of a photo shows, the first may begin before it.
        start: (B, 2) float64, where the coarser panel's corner lies on the real one, in its pixels.
    """

    scale: Any
    ratio: Any
    optics: Optics
    shift: Any
    width: Any
    interpolation_variance: Any
    lead: Any
    start: Any

    def footprint(self, axis: int, bins: Bins) -> Footprint:
        """Return the view of bins along x (axis 0) or y (axis 1), without `interpolation_variance`:
        (B, h, w) each, in pixels."""
        ratio = self.ratio.to(bins.step.dtype)[:, None, None, None]
        step = bins.step[..., axis, :] / ratio
        across_bin = (step[..., None] * bins.window).sum(-2)
        zero, one = torch.zeros_like(self.ratio), torch.ones_like(self.ratio)
        box = Footprint.of(across_bin, Optics(one, zero, zero, zero, zero))
        return Footprint(box.box, box.variance + blur_variance(step, self.optics))


def content_of(shot: ShotGeometry) -> BinContent:
    """Return the BinContent of a shot, of its library's arrays.

    A panel of more pixels than the picture shows more than the picture holds: with `Panel.width`,
    whatever has the picture's pixels as its means; with `Panel.scale`, the picture itself,
    interpolated. A bin then sees image pixels, in the latter case each a little wider.
    """
    scene, alpha, xp = shot.scene, shot.panel_scale, shot.xp
    ratio = alpha.clip(min=1)
    fine = 1 - 1 / ratio  # 0 for a panel of the picture's pixels, near 1 for a much finer one
    interpolation = xp.zeros_like(fine)
    if not scene.panel.width:
        # the filter that shrinks the photo blurs the picture, too, where its pixels are not means
        second_mean = 1.0 if scene.develop.resize == "antialias" else 0.0
        interpolation = (fine + second_mean * alpha.clip(max=1) ** 2) / 12
    corner = shot.panel_corner
    lead = xp.where(alpha[:, None] < 1, corner - xp.floor(corner), 0.0)
    middle, edges, is_whole = (array_like(one, alpha) for one in _sources(scene.panel.cell))
    lit_x, lit_y = (share[:, None, None] for share in emitting_share(shot.panel))
    # the larger of its two edges, one across and one down
    width = xp.maximum(edges[..., 0] * lit_x, edges[..., 1] * lit_y).clip(max=1)
    width = xp.where(is_whole > 0, 1.0, width)
    return BinContent(
        scale=alpha.clip(max=1),
        ratio=ratio,
        optics=gaussian_optics(scene, optics_of(shot)),
        shift=middle / ratio[:, None, None],
        width=width + (1 - width) * fine[:, None, None],
        interpolation_variance=interpolation,
        lead=lead,
        start=corner - ratio[:, None] * lead,
    )


def gaussian_optics(scene: SceneRecord, optics: Optics) -> Optics:
    """Return the optics of a sensor pixel with its aperture, and the spread that holding and
    interpolation add, as a Gaussian."""
    extra = BAYER_HOLD_VARIANCE if scene.is_binned_bayer else HOLD_VARIANCE
    variance = optics.blur**2 + optics.fill**2 / 12 + extra
    return optics._replace(fill=library_of(variance).zeros_like(variance), blur=variance**0.5)


@functools.lru_cache(maxsize=64)
def _sources(layout: Layout) -> tuple[list, list, list]:
    """Return where in a panel pixel each channel's light comes from: its subpixel, or if it has
    several, the whole pixel, about their middle.

    Returns:
        (3, 2) the middle along x and y, from that of the pixel; (3, 2, 2) the lengths along x and y
        of the subpixel's two edges; and (3, 1) whether it is the whole pixel.
    """
    middles, edges, whole = [], [], []
    for channel in range(3):
        subpixels = layout.of(channel)
        is_single = len(subpixels) == 1 and subpixels[0].period == (1, 1)
        if is_single:
            (x, y), across, down = subpixels[0].centre, subpixels[0].across, subpixels[0].down
        else:
            (x, y), across, down = _mean_place(subpixels), (1.0, 0.0), (0.0, 1.0)
        middles.append([x - 0.5, y - 0.5])
        edges.append([[abs(across[axis]), abs(down[axis])] for axis in (0, 1)])
        whole.append([not is_single])
    return middles, edges, whole


def _mean_place(subpixels: Sequence[Subpixel]) -> tuple[float, float]:
    """Return the mean place of some subpixels in their panel pixels, weighted by their area."""
    if not subpixels:
        return 0.5, 0.5
    total, x, y = 0.0, 0.0, 0.0
    for subpixel in subpixels:
        total += subpixel.density
        x += subpixel.density * (subpixel.centre[0] - subpixel.pixel[0] + 0.5)
        y += subpixel.density * (subpixel.centre[1] - subpixel.pixel[1] + 0.5)
    return x / total, y / total
