"""What sensor pixels and bins see of a panel in the extreme views that a scene's ranges allow: how
far they see, and which harmonics a reading can show."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import replace

import torch
from torch import Tensor

from moireaug.camera.exposure.axis_views import (
    WHOLE_PIXEL,
    AxisView,
    axis_views,
    variance_beyond_taps,
)
from moireaug.camera.exposure.bin_content import gaussian_optics
from moireaug.camera.exposure.extremes import (
    FLOAT64_ON_CPU,
    can_saturate,
    extreme_jacobians,
    largest_panel_steps,
    least_bin_scale,
    least_side,
    panel_scale_ratio,
    range_points,
    smallest_panel_steps,
)
from moireaug.camera.exposure.footprint import Footprint, Optics, blur_variance
from moireaug.camera.panel import coefficient, own_orders
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord

HIGHEST_ORDER = 32  # highest harmonic per panel pixel that is ever summed


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
        bin_views.append(AxisView(WHOLE_PIXEL, axis, widest, torch.ones((), **FLOAT64_ON_CPU)))
    return bin_views


@functools.lru_cache(maxsize=64)
def harmonics(scene: SceneRecord) -> list[tuple[tuple[int, int], float]]:
    """Return the harmonics whose contrast in the raw reading can exceed the tolerance, strongest
    first.

    The sinc of the aperture is bounded by its envelope, because its zeros move with the view; so is
    the cosine of a low-pass filter.
    """
    if scene.sensor.pitch and scene.panel.scale != 1:  # the same however large the picture is shown
        return harmonics(scene.with_parts(panel=replace(scene.panel, scale=1.0)))
    px, py = scene.panel.cell.period
    k, l = _orders(px, py)
    amplitude = 2 * bounds(scene.sensor.gain)[1] * _strongest(scene, k, l)
    step = largest_panel_steps(scene)

    # cycles per sensor pixel, at least, in any view; along one axis no less than this over sqrt 2
    least = torch.linalg.svdvals(step)[:, 1].min() * (k / px).hypot(l / py)
    most = amplitude * _through_aperture(scene, least / 2**0.5)
    possible = most * _through_lens(scene, least.square()) > scene.tolerance
    k, l, amplitude = k[possible], l[possible], amplitude[possible]
    if not len(k):
        return []

    # (K, N, 2), along both axes in each view
    frequency = (k / px)[:, None, None] * step[:, 0] + (l / py)[:, None, None] * step[:, 1]
    passed = _through_aperture(scene, frequency).prod(-1)
    passed *= _through_lens(scene, frequency.square().sum(-1))
    contrast = amplitude * passed.amax(1)
    strong = []
    for k_, l_, strength in zip(k.tolist(), l.tolist(), contrast.tolist(), strict=True):
        if strength > scene.tolerance:
            strong.append(((int(k_), int(l_)), strength))
    return sorted(strong, key=lambda item: -item[1])


@functools.lru_cache(maxsize=64)
def harmonics_in_bins(scene: SceneRecord) -> list[tuple[tuple[int, int], float]]:
    """Return those harmonics whose contrast can exceed the tolerance in a binned reading, strongest
    first: as their slowest alias can be in any view, at any scale, in the smallest bin. Where the
    reading can exceed a full well, all are kept: pixels that saturate before they are averaged turn
    contrast into a change of the mean."""
    if can_saturate(scene):
        return harmonics(scene)
    layout, step = scene.panel.cell, largest_panel_steps(scene)
    ratio = panel_scale_ratio(scene)
    s = least_side(scene, bounds(scene.panel.scale)[0])
    apart = 0.5 if scene.is_binned_bayer else 1.0
    strong = []
    for (k, l), strength in harmonics(scene):
        frequency = step[:, 0] * (k / layout.period[0]) + step[:, 1] * (l / layout.period[1])
        any_scale = torch.cat([frequency, frequency * ratio])
        ends = zip(any_scale.amin(0).tolist(), any_scale.amax(0).tolist(), strict=True)
        alias = [_slowest_alias(least, most, apart) for least, most in ends]
        # a bin's side may lie along the alias, and the other across it; or both along an axis
        along_sides = [math.hypot(*alias)] if scene.is_rectified else alias
        transfer = math.prod(_max_transfer(frequency, s) for frequency in along_sides)
        if strength * transfer > scene.tolerance:
            strong.append(((k, l), strength * transfer))
    return sorted(strong, key=lambda item: -item[1])


def _slowest_alias(low: float, high: float, apart: float) -> float:
    """Return the least frequency along one axis of the aliases, which lie `apart`, of frequencies
    from `low` to `high`."""
    if high - low >= apart:  # an alias of one of them stands still
        return 0.0
    slowest = 1.0
    for m in range(math.floor(low / apart), math.floor(high / apart) + 2):
        least, most = low - m * apart, high - m * apart
        slowest = min(slowest, 0.0 if least <= 0 <= most else min(abs(least), abs(most)))
    return slowest


def _max_transfer(frequency: float, s: float) -> float:
    """Return the greatest transfer of the mean over s sensor pixels at a frequency, by the envelope
    of sinc(s g)."""
    return min(1.0, 1 / (math.pi * max(s, 1.0) * frequency)) if frequency else 1.0


def _orders(px: int, py: int) -> tuple[Tensor, Tensor]:
    """Return k and l of every harmonic of a cell but the mean, one of each conjugate pair."""
    k = torch.arange(HIGHEST_ORDER * px + 1, **FLOAT64_ON_CPU)
    l = torch.arange(-HIGHEST_ORDER * py, HIGHEST_ORDER * py + 1, **FLOAT64_ON_CPU)
    k, l = torch.meshgrid(k, l, indexing="ij")
    counted = (k > 0) | (l > 0)
    return k[counted], l[counted]


def _strongest(scene: SceneRecord, k: Tensor, l: Tensor) -> Tensor:
    """Return how strong each of a layout's harmonics can be, in its strongest colour."""
    panel, layout = scene.panel, scene.panel.cell
    lit = range_points(panel.lit, points=9)
    along = range_points(panel.lit_x, points=5), range_points(panel.lit_y, points=5)
    emitting = torch.tensor(list(itertools.product(lit, *along)), **FLOAT64_ON_CPU)
    width = (emitting[:, 0].sqrt() * emitting[:, 1])[None]
    height = (emitting[:, 0].sqrt() * emitting[:, 2])[None]
    strongest = torch.zeros(3, len(k), **FLOAT64_ON_CPU)
    for subpixel in layout.all():
        own_k, own_l, has = own_orders(subpixel, layout, k, l)
        c = coefficient(subpixel, own_k[:, None], own_l[:, None], width, height)
        strongest[subpixel.channel] += c.abs().amax(1) * has
    return strongest.amax(0)


def _through_aperture(scene: SceneRecord, frequency: Tensor) -> Tensor:
    """Bound the sinc of the smallest aperture along one axis; frequency in cycles per sensor
    pixel."""
    fill = bounds(scene.sensor.fill)[0]
    return 1 / (math.pi * fill * frequency.abs()).clamp(min=1.0)


def _through_lens(scene: SceneRecord, squared: Tensor) -> Tensor:
    """Return the transfer of the sharpest lens at this squared frequency."""
    return torch.exp(-2 * math.pi**2 * bounds(scene.lens.blur)[0] ** 2 * squared)
