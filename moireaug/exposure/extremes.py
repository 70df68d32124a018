"""The extremes that a scene's ranges allow, by which its exposure is chosen."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from moireaug.exposure.bin_content import spread_of
from moireaug.exposure.content import Footprint, footprint, spread
from moireaug.exposure.optics import Optics
from moireaug.exposure.seen import WHOLE_PIXEL, footprints_of
from moireaug.geometry.grids import image_to_photo, jacobian
from moireaug.geometry.homography import homography, magnification
from moireaug.panel.fourier import coefficient
from moireaug.scene.fields import Range, bounds
from moireaug.scene.layout import as_layout
from moireaug.scene.parts import Lens, View
from moireaug.scene.record import SceneRecord

# height and width; what holds for these holds for most images
SHAPES = ((256, 256), (192, 256), (256, 192))
STRIPS = ((16, 256), (256, 16))  # perspective is strongest along a long strip
HIGHEST = 32  # highest harmonic per panel pixel that is ever summed
# a scene's plan depends neither on torch's default dtype nor on its default device
PRECISE: dict[str, Any] = {"dtype": torch.float64, "device": "cpu"}


def inside(value: Range, *marks: float, points: int = 2) -> list[float]:
    """Return a range's ends, evenly spread points between them, and those of `marks` that it
    holds."""
    low, high = bounds(value)
    spread = [low + (high - low) * i / (points - 1) for i in range(points)]
    return sorted({*spread, *(m for m in marks if low < m < high)})


def views(scene: SceneRecord, zoom: float, *, usual: bool, magnified: bool = False) -> Tensor:
    """Return image pixels per photo pixel, d(x, y) / d(u, v), at the corners and the centre of the
    picture, and where it reaches past the photo's corners also as far out as these, for the angles
    and lenses that a scene allows at this zoom: (N, 2, 2) float64. `usual` leaves out long
    strips; `magnified` gives them times the photo pixels that an image pixel in the middle takes
    before it is turned, which no zoom changes."""
    shapes = SHAPES if usual else SHAPES + STRIPS
    return _views(scene.view, scene.lens, scene.sensor.scale, zoom, shapes, magnified)


@functools.lru_cache(maxsize=64)
def _views(
    v: View, lens: Lens, scale: float, zoom: float, shapes: tuple, magnified: bool
) -> Tensor:
    fields, k1, k2 = _poses(v, lens, zoom)
    found = []
    for size in shapes:
        h, w = size
        m = homography(fields, k1, k2, size, scale, pose=v.pose, fit=v.fit)
        picture = torch.tensor([[0, 0], [w, 0], [0, h], [w, h], [w / 2, h / 2]], **PRECISE)
        points = image_to_photo(picture.expand(len(m), -1, -1), m, size, (k1, k2))
        points = torch.cat([points, _in_the_photo(points, size)], 1)
        seen = jacobian(points[:, None], torch.linalg.inv(m), size, (k1, k2))
        if magnified:
            seen = seen * magnification(fields, k1, k2, size, v.fit)[:, None, None, None, None]
        found.append(seen.flatten(0, 2))
    return torch.cat(found).unique(dim=0)


@functools.lru_cache(maxsize=64)
def _least_magnification(v: View, lens: Lens) -> float:
    """Return the least `homography.magnification` for the angles and lenses that a scene allows."""
    fields, k1, k2 = _poses(v, lens, bounds(v.zoom)[0])
    return min(float(magnification(fields, k1, k2, size, v.fit).min()) for size in SHAPES)


def _poses(v: View, lens: Lens, zoom: float) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """Return the fields of views of the angles that a scene allows, k1 and k2, (N,) each."""
    turns = [inside(a, 0.0) for a in (v.yaw, v.pitch)]
    rolls = inside(v.roll, 0.0, 90.0, -90.0, points=9)
    poses = itertools.product(*turns, rolls, inside(lens.k1), inside(lens.k2))
    yaw, pitch, roll, k1, k2 = torch.tensor(list(poses), **PRECISE).T
    fields = {k: torch.zeros_like(yaw) for k in v.ranged}
    fields |= {"yaw": yaw, "pitch": pitch, "roll": roll}
    fields |= {"fov": torch.full_like(yaw, bounds(v.fov)[1]), "zoom": torch.full_like(yaw, zoom)}
    return fields, k1, k2


def _in_the_photo(points: Tensor, size: tuple[int, int]) -> Tensor:
    """Return photo points (B, N, 2), those farther from its centre than its corners moved towards
    it until they are as far."""
    centre = points.new_tensor([size[1] / 2, size[0] / 2])
    radius = (points - centre).norm(dim=-1, keepdim=True) / centre.norm()
    return torch.where(radius > 1, centre + (points - centre) / radius, points)


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
    shown = 2 * bounds(scene.sensor.gain)[1] * _strongest(scene, k, l)
    step = _steps(scene)

    # cycles per sensor pixel, at least, in any view; along one axis no less than this over sqrt 2
    least = torch.linalg.svdvals(step)[:, 1].min() * (k / px).hypot(l / py)
    most = shown * _through_aperture(scene, least / 2**0.5) * _through_lens(scene, least.square())
    possible = most > scene.tolerance
    k, l, shown = k[possible], l[possible], shown[possible]
    if not len(k):
        return []

    # (K, N, 2), along both axes in each view
    frequency = (k / px)[:, None, None] * step[:, 0] + (l / py)[:, None, None] * step[:, 1]
    passed = _through_aperture(scene, frequency).prod(-1)
    passed *= _through_lens(scene, frequency.square().sum(-1))
    contrast = shown * passed.amax(1)
    found = []
    for k_, l_, strength in zip(k.tolist(), l.tolist(), contrast.tolist(), strict=True):
        if strength > scene.tolerance:
            found.append(((int(k_), int(l_)), strength))
    return sorted(found, key=lambda item: -item[1])


@functools.lru_cache(maxsize=64)
def harmonics_in_bins(scene: SceneRecord) -> list[tuple[tuple[int, int], float]]:
    """Return those harmonics whose contrast can exceed the tolerance in a binned reading, strongest
    first: as their slowest alias can be in any view, of any pitch, in the smallest bin. Where
    sensor pixels may saturate, which they do by what bins average away, too, all of them."""
    if bounds(scene.sensor.gain)[1] > 1:
        return harmonics(scene)
    layout, step = as_layout(scene.panel.layout), _steps(scene)
    low, high = bounds(scene.sensor.pitch)
    s = least_side(scene, bounds(scene.panel.scale)[0])
    apart = 0.5 if scene.cells == "binned" else 1.0
    found = []
    for (k, l), strength in harmonics(scene):
        frequency = step[:, 0] * (k / layout.period[0]) + step[:, 1] * (l / layout.period[1])
        seen = torch.cat([frequency, frequency * (high / low if low else 1.0)])
        ends = zip(seen.amin(0).tolist(), seen.amax(0).tolist(), strict=True)
        alias = [_slowest_alias(least, most, apart) for least, most in ends]
        # along a side of the bin that lies anyhow; along the sensor's axes, along both
        ways = [math.hypot(*alias)] if scene.is_rectified else alias
        left = math.prod(_most_left(frequency, s) for frequency in ways)
        if strength * left > scene.tolerance:
            found.append(((k, l), strength * left))
    return sorted(found, key=lambda item: -item[1])


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
    k = torch.arange(HIGHEST * px + 1, **PRECISE)
    l = torch.arange(-HIGHEST * py, HIGHEST * py + 1, **PRECISE)
    k, l = torch.meshgrid(k, l, indexing="ij")
    counted = (k > 0) | (l > 0)
    return k[counted], l[counted]


def _strongest(scene: SceneRecord, k: Tensor, l: Tensor) -> Tensor:
    """Return how strong each of a layout's harmonics can be, in its strongest colour."""
    panel, layout = scene.panel, as_layout(scene.panel.layout)
    lit = inside(panel.lit, points=9)
    along = inside(panel.lit_x, points=5), inside(panel.lit_y, points=5)
    emitting = torch.tensor(list(itertools.product(lit, *along)), **PRECISE)
    width = (emitting[:, 0].sqrt() * emitting[:, 1])[None]
    height = (emitting[:, 0].sqrt() * emitting[:, 2])[None]
    strongest = torch.zeros(3, len(k), **PRECISE)
    for subpixel in layout.all():
        # in cycles per cell of its own, which must be whole
        across = k / (layout.period[0] // subpixel.period[0])
        down = l / (layout.period[1] // subpixel.period[1])
        there = (across == across.round()) & (down == down.round())
        c = coefficient(subpixel, across[:, None], down[:, None], width, height)
        strongest[subpixel.channel] += c.abs().amax(1) * there
    return strongest.amax(0)


def _through_aperture(scene: SceneRecord, frequency: Tensor) -> Tensor:
    """Bound the sinc of the smallest aperture along one axis; frequency in cycles per sensor
    pixel."""
    fill = bounds(scene.sensor.fill)[0]
    return 1 / (math.pi * fill * frequency.abs()).clamp(min=1.0)


def _through_lens(scene: SceneRecord, squared: Tensor) -> Tensor:
    """Return what the sharpest lens leaves of a wave of this squared frequency."""
    return torch.exp(-2 * math.pi**2 * bounds(scene.lens.blur)[0] ** 2 * squared)


def _steps(scene: SceneRecord) -> Tensor:
    """Return panel pixels per sensor pixel, d(x, y) / d(u, v), in the views that show the panel at
    its smallest, (N, 2, 2)."""
    zoom, (_, pitch) = bounds(scene.view.zoom)[1], bounds(scene.sensor.pitch)
    if pitch:
        return views(scene, zoom, usual=False, magnified=True) / pitch
    seen = views(scene, zoom, usual=False)
    return seen * (bounds(scene.panel.scale)[0] / scene.sensor.scale)


def least_bin_scale(scene: SceneRecord, alpha: float) -> float:
    """Return the least of `shot.bin_scale`, for `alpha` panel pixels per image pixel."""
    view, pitch = scene.view, bounds(scene.sensor.pitch)[0]
    if not scene.is_rectified:  # a picture that fits is at most as large as the photo
        return pitch * alpha / bounds(view.zoom)[1] if pitch else scene.sensor.scale
    yaw, tilt = (math.radians(max(map(abs, bounds(axis)))) for axis in (view.yaw, view.pitch))
    turned = math.sqrt(math.cos(yaw) * math.cos(tilt))
    if pitch:
        return pitch * alpha * turned
    return scene.sensor.scale * _least_magnification(view, scene.lens) * turned


def least_side(scene: SceneRecord, alpha: float) -> float:
    """Return the least side of a bin in any view, in sensor pixels, for `alpha` panel pixels per
    image pixel."""
    if not scene.is_rectified:
        return least_bin_scale(scene, alpha)
    zoom, pitch = bounds(scene.view.zoom)[0], bounds(scene.sensor.pitch)[0]
    seen = views(scene, zoom, usual=False, magnified=bool(pitch))
    farthest = float(torch.linalg.svdvals(seen)[:, 0].max())  # image pixels per photo pixel
    return (pitch * alpha if pitch else scene.sensor.scale) / farthest


def narrowest(scene: SceneRecord) -> float:
    """Return the smallest width of an aperture's shadow on the panel along an axis, in cells."""
    widest = _steps(scene).abs().amax(-1).amin(0)  # along x and y
    period = widest.new_tensor(as_layout(scene.panel.layout).period)
    return bounds(scene.sensor.fill)[0] * float((widest / period).min())


def footprints(
    scene: SceneRecord, seen: Tensor, alpha: float, *, whole_pixel: bool
) -> list[tuple[Footprint, Tensor, int]]:
    """Return `seen.footprints_of` for the widest spread that the optics allow."""
    sensor, lens = scene.sensor, scene.lens
    # as if the hand moved in every direction
    motion = math.hypot(*(max(map(abs, bounds(r))) for r in (lens.motion_x, lens.motion_y)))
    blur, fill, olpf = math.hypot(bounds(lens.blur)[1], motion), bounds(sensor.fill)[1], lens.olpf
    widest = (fill, blur, bounds(olpf)[1], 0.0, 0.0)
    optics = Optics(*(torch.tensor([value], **PRECISE) for value in widest))
    if scene.is_binned:
        return _footprints_of_bins(scene, seen, alpha, optics)
    step = seen[None, :, None] * (alpha / sensor.scale)
    lit = torch.ones(1, **PRECISE)
    kinds = [WHOLE_PIXEL] if whole_pixel else as_layout(scene.panel.layout).all()
    return footprints_of(kinds, step, (lit, lit), optics)


def _footprints_of_bins(
    scene: SceneRecord, seen: Tensor, alpha: float, optics: Optics
) -> list[tuple[Footprint, Tensor, int]]:
    """Return the footprints of bins on a panel of at most the picture's pixels; `optics` of a
    sensor pixel."""
    cells, least = min(alpha, 1.0), least_bin_scale(scene, alpha)
    photo_pixel, pitch = seen[None, :, None] * cells, bounds(scene.sensor.pitch)[0]
    per_sensor = seen * (alpha / scene.sensor.scale)  # panel pixels
    if pitch:
        per_sensor = views(scene, bounds(scene.view.zoom)[0], usual=True, magnified=True) / pitch
    side = torch.eye(2, **PRECISE)[None, None, None] * cells if scene.is_rectified else photo_pixel
    zero, one = torch.zeros(1, **PRECISE), torch.ones(1, 1, 1, **PRECISE)
    bin_ = Optics(one.flatten() * max(1.0, 1 / least), zero, zero, zero, zero)
    blur, found = spread_of(scene, optics), []
    for axis in (0, 1):
        box = footprint(side[..., axis, :], bin_)
        variance = spread(per_sensor[None, :, None, axis] * (cells / alpha), blur)
        widest = Footprint(box.box.max(), box.variance.max() + variance.max())
        found.append((Footprint(*(t.reshape(1, 1, 1) for t in widest)), one, 1))
    return found


def reach(scene: SceneRecord, seen: Tensor, *, whole_pixel: bool) -> float:
    """Return how many cells to each side a sensor pixel sees at most."""
    most = 0.0
    for alpha in inside(scene.panel.scale, 1.0):
        for along, width, _ in footprints(scene, seen, alpha, whole_pixel=whole_pixel):
            most = max(most, float(along.reach().max()) + float(width) / 2)
    return most
