"""A low-pass on the picture before it is looked up: where a sensor pixel sees more panel pixels
than are summed one by one."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.effects.base import Effect, Verdict, called, left_out
from moireaug.exposure import extreme_footprints, extreme_views
from moireaug.exposure.bin_content import content_of
from moireaug.exposure.bin_geometry import bins_on_image
from moireaug.exposure.binned import Binned
from moireaug.exposure.choose import method_of
from moireaug.exposure.footprints import Footprint, fitted
from moireaug.exposure.optics import optics_of
from moireaug.exposure.sampled import Sampled
from moireaug.exposure.sight import WHOLE_PIXEL, footprints_of
from moireaug.exposure.smooth import Mean
from moireaug.geometry import grids
from moireaug.numeric import repeat_edges
from moireaug.scene.fields import bounds
from moireaug.scene.layout import as_layout
from moireaug.scene.record import SceneRecord
from moireaug.shot import ShotRecord

MAX_PYRAMID_LEVELS = 10  # halvings of a picture seen from afar or at a grazing angle
MAX_NEIGHBOUR_VARIANCE = 0.5  # squared image pixels, of one pass over the neighbours


class Prefilter(Effect):
    """A blur of the picture whose variance differs from place to place."""

    name = "prefilter"

    def verdict(self, scene: SceneRecord) -> Verdict:
        variance = most_lost(scene)
        if 2 * bounds(scene.sensor.gain)[1] * variance <= scene.tolerance:
            return left_out("a sensor pixel sees few of the panel's pixels")
        return called(
            f"the picture blurred by up to {variance**0.5:.2g} image pixels before it is looked up"
        )

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        most = shot.plan.prefilter
        if most <= MAX_NEIGHBOUR_VARIANCE:
            return blur_by_neighbours(light, share_at_centre(shot))
        variance = variance_at(grids.pixel_centres(shot.size, light.device), shot)
        return mipmap(light, variance[:, None].to(light.dtype), levels(most))


def _middle(shot: ShotRecord) -> tuple[Tensor, Tensor]:
    h, w = shot.size
    return shot.panel_scale.new_tensor([h / 2]), shot.panel_scale.new_tensor([w / 2])


def variance_at(points: Tensor, shot: ShotRecord) -> Tensor:
    """Return the blur that the picture needs at image points (1, h, w, 2), in squared image pixels:
    (B, h, w)."""
    alpha, method = shot.panel_scale[:, None, None], shot.plan.method
    points = points.expand(len(alpha), -1, -1, -1)
    if isinstance(method, Binned):
        return _lost_by_bins(points, shot)
    on_photo = grids.image_to_photo(points.flatten(1, 2), shot.matrix(), shot.size, None).reshape(
        points.shape
    )
    step = grids.jacobian(on_photo, torch.linalg.inv(shot.matrix()), shot.size, None)
    kinds, optics = as_layout(shot.scene.panel.layout).all(), optics_of(shot)
    if isinstance(method, Mean):
        kinds = (WHOLE_PIXEL,)
    scale = step.new_tensor([pixels.scale for pixels in shot.sampled_pixels()[::-1]])
    step = step * alpha[..., None, None] / scale
    lit = torch.ones_like(shot.panel_scale)
    footprints = footprints_of(kinds, step, (lit, lit), optics)
    return lost_variance(footprints, alpha, method.taps)


def _lost_by_bins(points: Tensor, shot: ShotRecord) -> Tensor:
    """Return the variance that bins lose at image points (B, h, w, 2); see `variance_at`."""
    content, bins = content_of(shot), bins_on_image(points, shot)
    step = bins.step / content.ratio[:, None, None, None, None]
    one = torch.ones_like(shot.panel_scale)[:, None, None]
    footprints = [(content.footprint(axis, step, bins.sides), one, 1) for axis in (0, 1)]
    return lost_variance(footprints, content.scale[:, None, None], shot.plan.method.taps)


def lost_variance(
    footprints: Iterable[tuple[Footprint, Tensor, int]], alpha: Tensor | float, taps: int
) -> Tensor:
    """Return the most variance that views lose along an axis when narrowed to `taps` cells, in
    squared image pixels: of what `footprints_of` returns, for a panel of `alpha` panel pixels per
    image pixel."""
    lost = []
    for footprint, width, period in footprints:
        lost.append(fitted(footprint, width, taps)[1] * (period / alpha) ** 2)
    return torch.stack(lost).amax(0)


@functools.lru_cache(maxsize=64)
def most_lost(scene: SceneRecord) -> float:
    """Return the most variance that a view loses when narrowed to the cells that are looked up, in
    squared image pixels."""
    method, most = method_of(scene), 0.0
    if isinstance(method, Sampled):
        return 0.0
    views = extreme_views.views(scene, bounds(scene.view.zoom)[0], usual=True)
    whole = isinstance(method, (Mean, Binned))
    for alpha in extreme_views.inside(scene.panel.scale, 1.0, points=3):
        footprints = extreme_footprints.footprints(scene, views, alpha, whole_pixel=whole)
        cells = min(alpha, 1.0) if scene.is_binned else alpha
        most = max(most, float(lost_variance(footprints, cells, method.taps).max()))
    return most


def levels(variance: float) -> int:
    """Return the number of halvings in a pyramid that reaches this variance."""
    return min(MAX_PYRAMID_LEVELS, max(1, math.ceil(math.log(4 * variance, 4))))


def share_at_centre(shot: ShotRecord) -> Tensor:
    """Return the share of a pixel's light that comes from its neighbours along each axis, (B,): the
    variance that the middle of the picture needs, in squared image pixels, up to 1/2."""
    return variance_at(grids.grid(*_middle(shot)), shot).flatten().clamp(max=MAX_NEIGHBOUR_VARIANCE)


def blur_by_neighbours(image: Tensor, share: Tensor) -> Tensor:
    """Blur (B, 3, H, W) along both axes by taking a share (B,) of each pixel from its two
    neighbours.

    The share is also the blur's variance: exact for a picture's curvature, which is what a small
    aperture sees.
    """
    share = share.to(image.dtype)[:, None, None, None]
    wide = repeat_edges(image, 1, 1, 1, 1)
    wide = wide[..., 1:-1] * (1 - share) + (wide[..., :-2] + wide[..., 2:]) * (share / 2)
    return wide[..., 1:-1, :] * (1 - share) + (wide[..., :-2, :] + wide[..., 2:, :]) * (share / 2)


def mipmap(image: Tensor, variance: Tensor, levels: int) -> Tensor:
    """Blur (B, 3, H, W) by a variance (B, 1, H, W), in squared image pixels, that differs from
    place to place.

    Mixes neighbouring levels of a pyramid of `levels` halvings to the right variance, which ends at
    the last level's.
    """
    n, _, h, w = image.shape
    x, y = grids.pixel_centres((h, w), image.device).expand(n, -1, -1, -1).unbind(-1)
    small, out, below = image, image, 0.0
    for j in range(1, levels + 1):
        small = halved(small)
        coarse = grids.look_up(small, x / 2**j, y / 2**j)
        above = 4**j / 4  # variance of a box of 2^j pixels and of the bilinear interpolation
        share = ((variance - below) / (above - below)).clamp(0, 1)
        out, below = out + share * (coarse - out), above
    return out


def halved(image: Tensor) -> Tensor:
    """Return the means of 2 x 2 pixels; an odd last row or column counts twice, so that every
    window is full."""
    h, w = image.shape[-2:]
    return F.avg_pool2d(repeat_edges(image, 0, w % 2, 0, h % 2), 2)
