"""The extremes that a scene's ranges allow: of its views, of how many of the panel's pixels a
sensor pixel sees, of how many sensor pixels a photo pixel takes, and of its light.

Both scales follow from `Sensor.pitch` where it is given, which holds in the picture's middle
whatever the zoom; else from `Panel.scale` and `Sensor.scale`, which are those of a view that shows
the picture at the photo's size.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any

import torch
from torch import Tensor

from moireaug.scene.fields import Range, bounds, deviation
from moireaug.scene.geometry.grids import image_to_photo, jacobian
from moireaug.scene.geometry.homography import about_corners, camera_pose, focal_length, pose_of
from moireaug.scene.parts import Lens, View
from moireaug.scene.record import SceneRecord

# height and width; extremes of these hold for most images
PHOTO_SHAPES: tuple[tuple[int, int], ...] = ((256, 256), (192, 256), (256, 192))
STRIP_SHAPES = ((16, 256), (256, 16))  # perspective is strongest along a long strip
# a scene's plan depends neither on torch's default dtype nor on its default device
FLOAT64_ON_CPU: dict[str, Any] = {"dtype": torch.float64, "device": "cpu"}


def range_points(value: Range, *inner: float, points: int = 2) -> list[float]:
    """Return a range's ends, evenly spread points between them, and those of `inner` that lie
    between."""
    low, high = bounds(value)
    even = [low + (high - low) * i / (points - 1) for i in range(points)]
    return sorted({*even, *(m for m in inner if low < m < high)})


def extreme_jacobians(
    scene: SceneRecord, zoom: float, *, with_strips: bool, magnified: bool = False
) -> Tensor:
    """Return d(x, y) / d(u, v), image pixels per photo pixel, (N, 2, 2) float64, for the angles and
    lenses that a scene allows at this zoom.

    They are taken at the picture's centre and corners, or of crops at those of the part of the
    photo that they see. Corners outside the circle through the photo's corners are also taken where
    the line to its centre meets it.

    Args:
        with_strips: include photos that are long strips, which no crop is a part of.
        magnified: multiply by `camera_pose`'s magnification; the product does not depend on zoom.
    """
    shapes, seen, focal = PHOTO_SHAPES, None, None
    if scene.is_crop:
        seen = bounds(scene.sensor.crop_x), bounds(scene.sensor.crop_y)
        focal = scene.sensor.focal
    elif with_strips:
        shapes += STRIP_SHAPES
    scale = scene.sensor.scale
    return _extreme_jacobians(scene.view, scene.lens, scale, zoom, shapes, magnified, seen, focal)


@functools.lru_cache(maxsize=64)
def _extreme_jacobians(
    v: View,
    lens: Lens,
    scale: float,
    zoom: float,
    shapes: tuple,
    magnified: bool,
    seen: tuple | None,
    focal_per_side: float | None,
) -> Tensor:
    view, distortion = _poses(v, lens, zoom, bounds(v.fov)[1])
    jacobians = []
    for size in shapes:
        h, w = size
        focal = focal_per_side * max(size) if focal_per_side else focal_length(view.fov, size)
        pose, magnification = pose_of(view, distortion, size, focal, scale)
        m = about_corners(pose, size)
        (left, right), (top, bottom) = seen or ((0, 1), (0, 1))
        corners = [(w * x, h * y) for x, y in itertools.product((left, right), (top, bottom))]
        picture = torch.tensor([*corners, (w / 2, h / 2)], **FLOAT64_ON_CPU)
        points = picture.expand(len(m), -1, -1)
        if seen is None:
            points = image_to_photo(points, m, size, distortion)
        points = torch.cat([points, _in_the_photo(points, size)], 1)
        local = jacobian(points[:, None], torch.linalg.inv(m), size, distortion)
        if magnified:
            local = local * magnification[:, None, None, None, None]
        jacobians.append(local.flatten(0, 2))
    return torch.cat(jacobians).unique(dim=0)


@functools.lru_cache(maxsize=64)
def magnifications(v: View, lens: Lens, zoom: float) -> tuple[float, float]:
    """Return the least and the greatest photo pixels that an image pixel takes, see
    `homography.camera_pose`, for the angles and lenses that a scene allows at this zoom."""
    every = []
    for fov in bounds(v.fov):
        view, distortion = _poses(v, lens, zoom, fov)
        for size in PHOTO_SHAPES:
            every.append(camera_pose(view, distortion, size, focal_length(view.fov, size))[1])
    return float(torch.cat(every).min()), float(torch.cat(every).max())


def _poses(v: View, lens: Lens, zoom: float, fov: float) -> tuple[Any, tuple[Tensor, Tensor]]:
    """Return a DrawnView of the angles that a scene allows, and k1 and k2, (N,) each."""
    turns = [range_points(a, 0.0) for a in (v.yaw, v.pitch)]
    rolls = range_points(v.roll, 0.0, 90.0, -90.0, points=9)
    poses = itertools.product(*turns, rolls, range_points(lens.k1), range_points(lens.k2))
    yaw, pitch, roll, k1, k2 = torch.tensor(list(poses), **FLOAT64_ON_CPU).T
    fields = {k: torch.zeros_like(yaw) for k in v.ranged}
    fields |= {"yaw": yaw, "pitch": pitch, "roll": roll}
    fields |= {"fov": torch.full_like(yaw, fov), "zoom": torch.full_like(yaw, zoom)}
    return v.drawn(fields), (k1, k2)


def _in_the_photo(points: Tensor, size: tuple[int, int]) -> Tensor:
    """Return photo points (B, N, 2), those farther from its centre than its corners moved towards
    it until they are as far."""
    centre = points.new_tensor([size[1] / 2, size[0] / 2])
    radius = (points - centre).norm(dim=-1, keepdim=True) / centre.norm()
    return torch.where(radius > 1, centre + (points - centre) / radius, points)


def largest_panel_steps(scene: SceneRecord) -> Tensor:
    """Return panel pixels per sensor pixel, d(x, y) / d(u, v), in the views that show the panel at
    its largest, where its harmonics have their lowest frequencies: (N, 2, 2) float64."""
    return _panel_steps(scene, 1, bounds(scene.panel.scale)[0], with_strips=True)


def smallest_panel_steps(scene: SceneRecord, alpha: float, *, with_strips: bool) -> Tensor:
    """Return the same in the views that show the panel at its smallest, for `alpha` panel pixels
    per image pixel; with_strips: as in `extreme_jacobians`."""
    return _panel_steps(scene, 0, alpha, with_strips=with_strips)


def _panel_steps(scene: SceneRecord, end: int, alpha: float, *, with_strips: bool) -> Tensor:
    """Return panel pixels per sensor pixel at an end, 0 or 1, of the ranges of zoom and pitch."""
    zoom, pitch = bounds(scene.view.zoom)[end], bounds(scene.sensor.pitch)[end]
    if pitch:
        return extreme_jacobians(scene, zoom, with_strips=with_strips, magnified=True) / pitch
    return extreme_jacobians(scene, zoom, with_strips=with_strips) * (alpha / scene.sensor.scale)


def panel_scale_ratio(scene: SceneRecord) -> float:
    """Return the most over the least panel pixels per sensor pixel, in a view of the same
    angles."""
    pitch = bounds(scene.sensor.pitch)
    if pitch[0]:
        return pitch[1] / pitch[0]
    scale, zoom = bounds(scene.panel.scale), bounds(scene.view.zoom)
    return scale[1] / scale[0] * zoom[1] / zoom[0]


def least_bin_scale(scene: SceneRecord, alpha: float) -> float:
    """Return the least of `shot.bin_scale`, for `alpha` panel pixels per image pixel, which a
    crop's does not depend on."""
    view, zoom, pitch = scene.view, bounds(scene.view.zoom), bounds(scene.sensor.pitch)[0]
    shrink = bounds(scene.sensor.shrink)[0]
    if not scene.is_rectified:
        if shrink:
            return shrink
        if not pitch:
            return scene.sensor.scale
        return pitch * alpha / magnifications(view, scene.lens, zoom[1])[1]
    # torch.compile follows this where a pitch is given, and could not follow a view's magnification
    per_image_pixel = shrink * zoom[0] if shrink else pitch * alpha
    if not pitch and not shrink:
        per_image_pixel = scene.sensor.scale * magnifications(view, scene.lens, zoom[0])[0]
    yaw, tilt = (math.radians(max(map(abs, bounds(axis)))) for axis in (view.yaw, view.pitch))
    return per_image_pixel * math.sqrt(math.cos(yaw) * math.cos(tilt))


def least_side(scene: SceneRecord, alpha: float) -> float:
    """Return the least side of a bin in any view, in sensor pixels, for `alpha` panel pixels per
    image pixel."""
    if not scene.is_rectified:
        return least_bin_scale(scene, alpha)
    if scene.develop.resize == "point":
        return 1.0
    shrink, zoom = bounds(scene.sensor.shrink)[0], bounds(scene.view.zoom)[0]
    if shrink:
        steps = extreme_jacobians(scene, zoom, with_strips=True)
    else:
        steps = smallest_panel_steps(scene, alpha, with_strips=True)
    return (shrink or alpha) / float(torch.linalg.svdvals(steps)[:, 0].max())


def modulation_depth(scene: SceneRecord) -> float:
    """Return the most by which a row's light can differ from the mean, as a share of it."""
    panel, (short, long) = scene.panel, bounds(scene.sensor.shutter)
    (slow, fast), duty = bounds(panel.pwm), bounds(panel.duty)[0]
    if not fast or not long or duty == 1:
        return 0.0
    cycles = slow * short  # the fewest in an exposure
    brighter = (1 - duty) / max(duty, cycles)
    darker = 1.0 if cycles <= 1 - duty else (1 - duty) / cycles
    return max(brighter, darker)


def max_glare(scene: SceneRecord) -> float:
    """Return the most light that the glass can reflect, which it does in a corner of the photo."""
    panel = scene.panel
    return bounds(panel.glare)[1] * (1 + deviation(panel.glare_x, 0) + deviation(panel.glare_y, 0))


def can_saturate(scene: SceneRecord) -> bool:
    """Return whether the reading of a white screen can exceed a full well."""
    brightest = 1 + modulation_depth(scene) + max_glare(scene)
    return bounds(scene.sensor.gain)[1] * brightest > 1 + scene.tolerance
