"""The footprints of a scene's sensor pixels on its panel, as wide and as narrow as its ranges
allow."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.camera.exposure.axis_views import AxisView, axis_views, variance_beyond_taps
from moireaug.camera.exposure.bin_content import gaussian_optics
from moireaug.camera.exposure.extreme_scales import (
    largest_panel_steps,
    least_bin_scale,
    smallest_panel_steps,
)
from moireaug.camera.exposure.extreme_views import FLOAT64_ON_CPU, extreme_jacobians, range_points
from moireaug.camera.exposure.footprint import Footprint, blur_variance
from moireaug.camera.exposure.optics import Optics
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord


def min_aperture_width(scene: SceneRecord) -> float:
    """Return the smallest width of an aperture's shadow on the panel along an axis, in cells."""
    widest = largest_panel_steps(scene).abs().amax(-1).amin(0)  # along x and y
    period = widest.new_tensor(scene.panel.cell.period)
    return bounds(scene.sensor.fill)[0] * float((widest / period).min())


def max_reach(scene: SceneRecord) -> float:
    """Return how many cells to each side a sensor pixel sees at most."""
    most = 0.0
    for alpha in range_points(scene.panel.scale, 1.0):
        for view in widest_views(scene, alpha):
            reach = float(view.footprint.reach().max()) + float(view.width) / 2
            most = max(most, reach)
    return most


def max_lost_variance(scene: SceneRecord, taps: int) -> float:
    """Return the most variance that a view loses when narrowed to `taps` cells, in squared image
    pixels."""
    most = 0.0
    for alpha in range_points(scene.panel.scale, 1.0, points=3):
        cells = min(alpha, 1.0) if scene.is_binned else alpha
        lost = variance_beyond_taps(widest_views(scene, alpha), cells, taps)
        most = max(most, float(lost.max()))
    return most


def widest_views(scene: SceneRecord, alpha: float) -> list[AxisView]:
    """Return the views of sensor pixels, or of bins, for the widest spread that the optics allow,
    on a panel of `alpha` pixels per image pixel."""
    optics = _widest_optics(scene)
    # a blur may be a little short at the far end of a strip
    jacobians = extreme_jacobians(scene, bounds(scene.view.zoom)[0], with_strips=False)
    image_views = jacobians[None, :, None]
    if not scene.is_binned:
        return axis_views(scene, image_views * (alpha / scene.sensor.scale), optics)
    return _views_of_bins(scene, image_views, alpha, optics)


def _widest_optics(scene: SceneRecord) -> Optics:
    sensor, lens = scene.sensor, scene.lens
    # as if the hand moved in every direction
    motion = math.hypot(*(max(map(abs, bounds(r))) for r in (lens.motion_x, lens.motion_y)))
    blur = math.hypot(bounds(lens.blur)[1], motion)
    widest = (bounds(sensor.fill)[1], blur, bounds(lens.olpf)[1], 0.0, 0.0)
    return Optics(*(torch.tensor([value], **FLOAT64_ON_CPU) for value in widest))


def _views_of_bins(
    scene: SceneRecord, image_views: Tensor, alpha: float, optics: Optics
) -> list[AxisView]:
    """Return the views of bins on a panel of at most the picture's pixels; `optics` of a sensor
    pixel."""
    cells = min(alpha, 1.0)
    if scene.is_crop:
        per_sensor_pixel = image_views * (cells / bounds(scene.sensor.shrink)[0])
    else:
        per_sensor_pixel = smallest_panel_steps(scene, alpha, with_strips=False)[None, :, None]
        per_sensor_pixel = per_sensor_pixel * (cells / alpha)
    per_bin = image_views * cells
    if scene.is_rectified:
        per_bin = torch.eye(2, **FLOAT64_ON_CPU)[None, None, None] * cells
    zero = torch.zeros(1, **FLOAT64_ON_CPU)
    enlarged = max(1.0, 1 / least_bin_scale(scene, alpha))
    bin_optics = Optics(zero + enlarged, zero, zero, zero, zero)
    pixel_optics = gaussian_optics(scene, optics)
    bin_views = []
    for axis in (0, 1):
        box, variance = Footprint.of(per_bin[..., axis, :], bin_optics)
        added = blur_variance(per_sensor_pixel[..., axis, :], pixel_optics)
        widest = Footprint(box.max(), variance.max() + added.max())
        bin_views.append(AxisView(widest, torch.ones((), **FLOAT64_ON_CPU), 1))
    return bin_views
