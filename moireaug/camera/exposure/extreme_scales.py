"""The extremes of the scales that a scene's ranges allow: how many of the panel's pixels a sensor
pixel sees, and how many sensor pixels a photo pixel takes.

Both follow from `Sensor.pitch` where it is given, which holds in the picture's middle whatever the
zoom; else from `Panel.scale` and `Sensor.scale`, which are those of a view that shows the picture
at the photo's size.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.camera.exposure.extreme_views import extreme_jacobians, magnifications
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord


def extreme_panel_steps(
    scene: SceneRecord, zoom: float, pitch: float, alpha: float, *, with_strips: bool
) -> Tensor:
    """Return panel pixels per sensor pixel, d(x, y) / d(u, v), in the views that a scene allows at
    this zoom: (N, 2, 2) float64. See `extreme_jacobians`.

    Args:
        pitch: sensor pixels per panel pixel; 0 if the scene states scales.
        alpha: panel pixels per image pixel, which matters if it does.
    """
    if pitch:
        return extreme_jacobians(scene, zoom, with_strips=with_strips, magnified=True) / pitch
    return extreme_jacobians(scene, zoom, with_strips=with_strips) * (alpha / scene.sensor.scale)


def largest_panel_steps(scene: SceneRecord) -> Tensor:
    """Return `extreme_panel_steps` of the views that show the panel at its largest, where its
    harmonics have their lowest frequencies."""
    zoom, pitch = bounds(scene.view.zoom)[1], bounds(scene.sensor.pitch)[1]
    return extreme_panel_steps(scene, zoom, pitch, bounds(scene.panel.scale)[0], with_strips=True)


def smallest_panel_steps(scene: SceneRecord, alpha: float, *, with_strips: bool) -> Tensor:
    """Return `extreme_panel_steps` of the views that show the panel at its smallest, for `alpha`
    panel pixels per image pixel."""
    zoom, pitch = bounds(scene.view.zoom)[0], bounds(scene.sensor.pitch)[0]
    return extreme_panel_steps(scene, zoom, pitch, alpha, with_strips=with_strips)


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
