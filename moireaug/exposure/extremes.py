"""The extremes that a scene's ranges allow, by which its exposure is chosen."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import replace

import torch
from torch import Tensor

from moireaug.exposure.bin_content import gaussian_optics
from moireaug.exposure.extreme_views import (
    FLOAT64_ON_CPU,
    inside,
    least_bin_scale,
    least_side,
    steps,
    views,
)
from moireaug.exposure.footprints import Footprint, blur_variance, footprint
from moireaug.exposure.optics import Optics
from moireaug.exposure.sight import WHOLE_PIXEL, footprints_of
from moireaug.panel.fourier import coefficient, own_orders
from moireaug.scene.fields import bounds
from moireaug.scene.layout import as_layout
from moireaug.scene.record import SceneRecord

HIGHEST_ORDER = 32  # highest harmonic per panel pixel that is ever summed


def harmonics(scene: SceneRecord) -> list[tuple[tuple[int, int], float]]:
    """Return the harmonics whose contrast at the sensor can exceed the tolerance, strongest first;
    see `_harmonics`."""
    if bounds(scene.sensor.pitch)[1]:  # however large the picture is shown
        scene = replace(scene, panel=replace(scene.panel, width=0.0, scale=1.0))
    return _harmonics(scene)


@functools.lru_cache(maxsize=64)
def _harmonics(scene: SceneRecord) -> list[tuple[tuple[int, int], float]]:
    """Return the harmonics whose contrast in the raw reading can exceed the tolerance, strongest
    first.

    The sinc of the aperture is bounded by its envelope, because its zeros move with the view; so is
    the cosine of a low-pass filter.
    """
    px, py = as_layout(scene.panel.layout).period
    k, l = _orders(px, py)
    amplitude = 2 * bounds(scene.sensor.gain)[1] * _strongest(scene, k, l)
    step = steps(scene)

    # cycles per sensor pixel, at least, in any view; along one axis no less than this over sqrt 2
    least = torch.linalg.svdvals(step)[:, 1].min() * (k / px).hypot(l / py)
    most = (
        amplitude * _through_aperture(scene, least / 2**0.5) * _through_lens(scene, least.square())
    )
    possible = most > scene.tolerance
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
    first: as their slowest alias can be in any view, at any scale, in the smallest bin. With a gain
    above 1 all are kept: pixels that saturate before they are averaged turn contrast into a change
    of the mean."""
    if bounds(scene.sensor.gain)[1] > 1:
        return harmonics(scene)
    layout, step = as_layout(scene.panel.layout), steps(scene)
    ratio = _scale_ratio(scene)
    s = least_side(scene, bounds(scene.panel.scale)[0])
    apart = 0.5 if scene.cells == "binned" else 1.0
    strong = []
    for (k, l), strength in harmonics(scene):
        frequency = step[:, 0] * (k / layout.period[0]) + step[:, 1] * (l / layout.period[1])
        any_scale = torch.cat([frequency, frequency * ratio])
        ends = zip(any_scale.amin(0).tolist(), any_scale.amax(0).tolist(), strict=True)
        alias = [_slowest_alias(least, most, apart) for least, most in ends]
        # a bin's side may lie along the alias, and the other across it; or both along an axis
        along_sides = [math.hypot(*alias)] if scene.is_rectified else alias
        left = math.prod(_most_left(frequency, s) for frequency in along_sides)
        if strength * left > scene.tolerance:
            strong.append(((k, l), strength * left))
    return sorted(strong, key=lambda item: -item[1])


def _scale_ratio(scene: SceneRecord) -> float:
    """Return the most over the least panel pixels per sensor pixel, in a view of the same
    angles."""
    pitch = bounds(scene.sensor.pitch)
    if pitch[0]:
        return pitch[1] / pitch[0]
    scale, zoom = bounds(scene.panel.scale), bounds(scene.view.zoom)
    return scale[1] / scale[0] * zoom[1] / zoom[0]


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


def _most_left(frequency: float, s: float) -> float:
    """Return the most that the mean over s sensor pixels leaves of a frequency, by the envelope of
    sinc(s g)."""
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
    panel, layout = scene.panel, as_layout(scene.panel.layout)
    lit = inside(panel.lit, points=9)
    along = inside(panel.lit_x, points=5), inside(panel.lit_y, points=5)
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
    """Return what the sharpest lens leaves of a wave of this squared frequency."""
    return torch.exp(-2 * math.pi**2 * bounds(scene.lens.blur)[0] ** 2 * squared)


def narrowest(scene: SceneRecord) -> float:
    """Return the smallest width of an aperture's shadow on the panel along an axis, in cells."""
    widest = steps(scene).abs().amax(-1).amin(0)  # along x and y
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
    photo_pixel, pitch = image_views[None, :, None] * cells, bounds(scene.sensor.pitch)[0]
    per_sensor = image_views * (alpha / scene.sensor.scale)  # panel pixels
    if pitch:
        per_sensor = views(scene, bounds(scene.view.zoom)[0], usual=True, magnified=True) / pitch
    side = photo_pixel
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
