"""A low-pass on the picture before it is looked up, where a sensor pixel sees more panel pixels
than the exposure sums: `ExposureMethod.lost_variance` says how wide."""

from __future__ import annotations

import functools
import math
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, left_out
from moireaug.camera.exposure.bin_geometry import middle_of_photo
from moireaug.camera.exposure.choose import method_of
from moireaug.common.numeric import repeat_edges
from moireaug.scene.fields import bounds
from moireaug.scene.geometry import grids
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

MAX_PYRAMID_LEVELS = 10  # halvings of a picture seen from afar or at a grazing angle
MAX_NEIGHBOUR_VARIANCE = 0.5  # squared image pixels, of one pass over the neighbours


class Prefilter(Effect):
    """Blurs the picture: a little by one variance for all of it, much by one for each place."""

    name = "prefilter"

    def verdict(self, scene: SceneRecord) -> Verdict:
        variance = max_lost_variance(scene)
        if not _is_seen(variance, scene):
            return left_out("a sensor pixel sees few of the panel's pixels")
        return called(
            f"the picture blurred by up to {variance**0.5:.2g} image pixels before it is looked up"
        )

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        largest = shot.plan.prefilter_variance
        if largest <= MAX_NEIGHBOUR_VARIANCE:
            return blur_by_neighbours(light, neighbour_share(shot))
        places = grids.pixel_centres(shot.size, light.device)
        variance = shot.plan.method.lost_variance(places, shot)
        return blur_by_pyramid(light, variance[:, None].to(light.dtype), levels_of(largest))


@functools.lru_cache(maxsize=64)
def max_lost_variance(scene: SceneRecord) -> float:
    """Return the largest variance that a scene's exposure leaves to the prefilter, in squared image
    pixels."""
    return method_of(scene).max_lost_variance(scene)


def _is_seen(variance: Any, scene: SceneRecord) -> Any:
    """Return whether leaving out a blur of a variance, in squared image pixels, would be seen."""
    return 2 * bounds(scene.sensor.gain)[1] * variance > scene.tolerance


@torch.no_grad()
def is_blurred(shot: ShotRecord) -> Tensor:
    """Return whether the prefilter blurs a picture anywhere, (B,) bool: views widen towards one of
    its corners, so these, the middles of its sides and its own tell."""
    h, w = shot.size
    places = [(x, y) for y in (0.5, h / 2, h - 0.5) for x in (0.5, w / 2, w - 0.5)]
    points = torch.tensor(places, dtype=torch.float64, device=shot.device).reshape(1, 3, 3, 2)
    variance = shot.plan.method.lost_variance(points, shot)
    return _is_seen(variance.amax((1, 2)), shot.scene)


def neighbour_share(shot: ShotRecord) -> Tensor:
    """Return the share of a pixel's light that comes from its neighbours along each axis, (B,): the
    variance that the middle of the picture needs, in squared image pixels, up to 1/2."""
    middle = middle_of_photo(shot)
    middle = middle - shot.frame.image_corner(middle)
    variance = shot.plan.method.lost_variance(middle, shot)
    return variance.flatten().clamp(max=MAX_NEIGHBOUR_VARIANCE)


def blur_by_neighbours(image: Tensor, share: Tensor) -> Tensor:
    """Blur (B, 3, H, W) along both axes by taking a share (B,) of each pixel from its two
    neighbours.

    The share is also the blur's variance: exact for a picture's curvature, which is all that a
    small aperture sees.
    """
    share = share.to(image.dtype)[:, None, None, None]
    wide = repeat_edges(image, 1, 1, 1, 1)
    wide = wide[..., 1:-1] * (1 - share) + (wide[..., :-2] + wide[..., 2:]) * (share / 2)
    return wide[..., 1:-1, :] * (1 - share) + (wide[..., :-2, :] + wide[..., 2:, :]) * (share / 2)


def levels_of(variance: float) -> int:
    """Return the number of halvings in a pyramid that reaches this variance."""
    return min(MAX_PYRAMID_LEVELS, max(1, math.ceil(math.log(4 * variance, 4))))


def blur_by_pyramid(image: Tensor, variance: Tensor, levels: int) -> Tensor:
    """Blur (B, 3, H, W) by a variance (B, 1, H, W), in squared image pixels, that differs from
    place to place.

    Level j of a pyramid, halved j times, has a variance of 4^j / 4: that of a box of 2^j pixels and
    of the interpolation between its pixels. Each place mixes the two levels around its own
    variance; one larger than the last level's ends there.
    """
    centres = grids.pixel_centres((image.shape[-2], image.shape[-1]), image.device)
    x, y = centres.expand(len(image), -1, -1, -1).unbind(-1)
    level, blurred, blurred_variance = image, image, 0.0
    for j in range(1, levels + 1):
        level = half_size(level)
        interpolated = grids.look_up(level, x / 2**j, y / 2**j)
        level_variance = 4**j / 4
        share = (variance - blurred_variance) / (level_variance - blurred_variance)
        blurred = blurred + share.clamp(0, 1) * (interpolated - blurred)
        blurred_variance = level_variance
    return blurred


def half_size(image: Tensor) -> Tensor:
    """Return the means of 2 x 2 pixels; an odd last row or column counts twice, so that every
    window is full."""
    h, w = image.shape[-2:]
    return F.avg_pool2d(repeat_edges(image, 0, w % 2, 0, h % 2), 2)
