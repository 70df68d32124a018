"""The footprints of a scene's sensor pixels on its panel, as wide and as narrow as its ranges
allow."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.exposure.bin_content import gaussian_optics
from moireaug.exposure.extreme_scales import (
    largest_panel_steps,
    least_bin_scale,
    smallest_panel_steps,
)
from moireaug.exposure.extreme_views import FLOAT64_ON_CPU, inside
from moireaug.exposure.footprints import Footprint, blur_variance, footprint
from moireaug.exposure.optics import Optics
from moireaug.exposure.sight import WHOLE_PIXEL, footprints_of
from moireaug.scene.fields import bounds
from moireaug.scene.layout import as_layout
from moireaug.scene.record import SceneRecord


def narrowest(scene: SceneRecord) -> float:
    """Return the smallest width of an aperture's shadow on the panel along an axis, in cells."""
    widest = largest_panel_steps(scene).abs().amax(-1).amin(0)  # along x and y
    period = widest.new_tensor(as_layout(scene.panel.layout).period)
    return bounds(scene.sensor.fill)[0] * float((widest / period).min())


def footprints(
    scene: SceneRecord, views: Tensor, alpha: float, *, whole_pixel: bool
) -> list[tuple[Footprint, Tensor, int]]:
    """Return `sight.footprints_of` for the widest spread that the optics allow."""
    sensor, lens = scene.sensor, scene.lens
    # as if the hand moved in every direction
    motion = math.hypot(*(max(map(abs, bounds(r))) for r in (lens.motion_x, lens.motion_y)))
    blur, fill, olpf = math.hypot(bounds(lens.blur)[1], motion), bounds(sensor.fill)[1], lens.olpf
    widest = (fill, blur, bounds(olpf)[1], 0.0, 0.0)
    optics = Optics(*(torch.tensor([value], **FLOAT64_ON_CPU) for value in widest))
    if scene.is_binned:
        return _footprints_of_bins(scene, views, alpha, optics)
    step = views[None, :, None] * (alpha / sensor.scale)
    lit = torch.ones(1, **FLOAT64_ON_CPU)
    kinds = [WHOLE_PIXEL] if whole_pixel else as_layout(scene.panel.layout).all()
    return footprints_of(kinds, step, (lit, lit), optics)


def _footprints_of_bins(
    scene: SceneRecord, image_views: Tensor, alpha: float, optics: Optics
) -> list[tuple[Footprint, Tensor, int]]:
    """Return the footprints of bins on a panel of at most the picture's pixels; `optics` of a
    sensor pixel."""
    cells, least = min(alpha, 1.0), least_bin_scale(scene, alpha)
    per_sensor = smallest_panel_steps(scene, alpha, usual=True)
    side = image_views[None, :, None] * cells
    if scene.is_rectified:
        side = torch.eye(2, **FLOAT64_ON_CPU)[None, None, None] * cells
    zero, one = torch.zeros(1, **FLOAT64_ON_CPU), torch.ones(1, 1, 1, **FLOAT64_ON_CPU)
    bin_ = Optics(one.flatten() * max(1.0, 1 / least), zero, zero, zero, zero)
    blur, footprints = gaussian_optics(scene, optics), []
    for axis in (0, 1):
        box = footprint(side[..., axis, :], bin_)
        variance = blur_variance(per_sensor[None, :, None, axis] * (cells / alpha), blur)
        widest = Footprint(box.box.max(), box.variance.max() + variance.max())
        footprints.append((Footprint(*(t.reshape(1, 1, 1) for t in widest)), one, 1))
    return footprints


def cells_to_each_side(scene: SceneRecord, views: Tensor, *, whole_pixel: bool) -> float:
    """Return how many cells to each side a sensor pixel sees at most."""
    most = 0.0
    for alpha in inside(scene.panel.scale, 1.0):
        for along, width, _ in footprints(scene, views, alpha, whole_pixel=whole_pixel):
            most = max(most, float(along.reach().max()) + float(width) / 2)
    return most
