"""From a Shot to its cameras and its panel's cell, and to how the pixels of a full reading see the
panel."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from moireaug.camera.effects.light import corner_steepness
from moireaug.camera.panel import emitting_share, mean_light_of, own_orders
from moireaug.engine.lower.exposure_records import Camera, Cell, FullView, PointView
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.exposure_method import ExposureMethod
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry
from moireaug.scene.subpixel import Subpixel

HOMOGRAPHY_FIELDS = [f"h{row}{column}" for row in range(3) for column in range(3)]


def camera_fields(geometry: HostGeometry) -> dict[str, np.ndarray]:
    """Return the fields of a shot's cameras that neither pose nor scale change; neutral values for
    effects that are not planned."""
    drawn, (h, w), (k1, k2) = geometry.numbers(), geometry.photo_size, geometry.lens_distortion
    zero = np.zeros_like(k1)

    def planned(effect: str, name: str, neutral: np.ndarray = zero) -> np.ndarray:
        return drawn[name] if effect in geometry.plan else neutral

    vignetting = planned("vignetting", "lens.vignetting")
    glare = planned("glare", "panel.glare")
    return {
        "k1": k1,
        "k2": k2,
        "radius_scale": zero + 4 / (h * h + w * w),
        "fill": drawn["sensor.fill"],
        "blur": drawn["lens.blur"],
        "olpf": drawn["lens.olpf"],
        "gain": planned("gain", "sensor.gain", zero + 1),
        "dark_noise": planned("noise", "sensor.read_noise"),
        "photon_noise": planned("noise", "sensor.shot_noise"),
        "falloff": corner_steepness(vignetting),
        "motion_x": drawn["lens.motion_x"],
        "motion_y": drawn["lens.motion_y"],
        "glare": glare,
        "glare_u": glare * drawn["panel.glare_x"] * 2 / w,
        "glare_v": glare * drawn["panel.glare_y"] * 2 / h,
        "rectified": zero,
        "photo_height": zero + h,
        "photo_width": zero + w,
        "centre_u": zero,
        "centre_v": zero,
        "lead_x": zero,
        "lead_y": zero,
        "corner_x": zero + w / 2,
        "corner_y": zero + h / 2,
        "pulses_top": zero - h / 2,
        "pulses_height": zero + h,
    }


def lower_cameras(
    inverse: np.ndarray,
    scales: tuple[float | np.ndarray, float | np.ndarray],
    fields: dict[str, np.ndarray],
) -> np.ndarray:
    """Return the fields of one Camera per image, (B, fields).

    Args:
        inverse: (B, 3, 3), homography from ideal photo coordinates about the centre to image
            coordinates.
        scales: sensor pixels per photo pixel, along rows and columns, one number or (B,) each.
        fields: (B,) each: `camera_fields` and alpha.
    """
    homography = dict(zip(HOMOGRAPHY_FIELDS, inverse.reshape(-1, 9).T, strict=True))
    columns = fields | homography | {"scale_u": scales[1], "scale_v": scales[0]}
    cameras = np.empty((len(inverse), len(Camera._fields)))
    for i, name in enumerate(Camera._fields):
        cameras[:, i] = columns[name]
    return cameras


def from_corner(m: np.ndarray, x: Any, y: Any) -> np.ndarray:
    """Move the origin of the image coordinates that homographies (B, 3, 3) lead to, from the
    centre to a corner x to its left and y above it, numbers or (B, 1) each."""
    out = m.copy()
    out[:, 0] += x * out[:, 2]
    out[:, 1] += y * out[:, 2]
    return out


def lower_cell(
    subpixels: Sequence[tuple[int, tuple[float, float], int]],
    periods: Sequence[tuple[int, int]],
    orders: Sequence[np.ndarray],
    radius: int,
) -> Cell:
    """Return the Cell of (channel, centre, kind) subpixels, centres in panel pixels from their
    cell's corner.

    Args:
        periods: of each kind. orders: of each kind, its harmonics' k and l, (2, n) int64.
        radius: see `Cell`.
    """
    channels, centres, kinds = zip(*subpixels, strict=True)
    kind, period = np.array(kinds, np.int64), np.array(periods, np.int64)
    centre = np.array(centres, np.float64)
    y_group = _numbered(period[kind, 1], centre[:, 1])
    return Cell(
        common_period=np.lcm.reduce(period),
        period=period,
        orders=np.array([highest_orders(o) for o in orders], np.int64),
        channel=np.array(channels, np.int64),
        subpixel_kind=kind,
        y_group=y_group,
        kind_y_group=_numbered(kind, y_group),
        centre=centre,
        pixel=np.floor(centre).astype(np.int64),
        radius=radius,
    )


def _numbered(*columns: np.ndarray) -> np.ndarray:
    """Return a number for each row of some columns, the same for equal ones."""
    rows = np.stack(columns, 1)
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def highest_orders(orders: np.ndarray) -> np.ndarray:
    """Return the highest k and the highest l of harmonics."""
    return np.abs(orders).max(1, initial=0)


@functools.lru_cache(maxsize=8)
def cell_of_whole_pixels(taps: int) -> Cell:
    """Return the Cell of a panel whose pixels emit all over, in each colour, of which `taps` are
    looked at along each axis."""
    subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
    none = np.empty((2, 0), np.int64)
    return lower_cell(subpixels, [(1, 1)] * 3, [none] * 3, taps // 2)


def cameras_and_cell(shot: ShotRecord, geometry: HostGeometry) -> tuple[np.ndarray, Cell]:
    """Return a shot's cameras, of sensor pixels, (B, fields), and its Cell."""
    rows, cols = shot.sampled_pixels()
    h, w = shot.size
    fields = camera_fields(geometry) | {"alpha": geometry.panel_scale}
    back = from_corner(np.linalg.inv(geometry.homography), w / 2, h / 2)
    cameras = lower_cameras(back, (rows.scale, cols.scale), fields)
    return cameras, _cell(shot.scene, shot.plan.method)


def point_view(geometry: HostGeometry) -> PointView:
    """Return the PointView of a shot whose exposure is "point"."""
    scene, (width, height) = geometry.scene, emitting_share(geometry.panel)
    rectangles = np.array([s.box() for _, s in _kinds(scene)[1]], np.float64)
    return PointView(rectangles, scene.panel.cell.raster, width * height)


def full_view(geometry: HostGeometry, cameras: np.ndarray) -> FullView:
    """Return a shot's FullView; cameras: of its sensor pixels."""
    scene = geometry.scene
    if not scene.shows_pattern:
        widths = np.ones((len(cameras), 3, 2))
        mean = mean_light_of(geometry)[:, :, None, None]
        return FullView(cameras, mean, widths, np.zeros_like(widths))
    width, height = emitting_share(geometry.panel)
    kinds, _ = _kinds(scene)
    shares = np.stack([width, height], 1)[:, None, :, None]  # of the edges across and down
    periods = np.array([s.period for s in kinds], np.float64)
    edges = np.array([(s.across, s.down) for s in kinds]) * shares / periods[:, None]
    long, short = np.abs(edges).max(-2), np.abs(edges).min(-2)
    coefficients = _coefficients(edges, _orders(scene, geometry.plan.method))
    return FullView(cameras, coefficients, long, short * short / 12)


def _coefficients(edges: np.ndarray, orders: list[np.ndarray]) -> np.ndarray:
    """Return `FullView.coefficients`.

    Args:
        edges: (B, kinds, 2, 2), two edge vectors of each kind, x then y, in cells.
        orders: of each kind, its harmonics' k and l, (2, n) int64: k >= 0, conjugates and (0, 0)
            left out.
    """
    n_k, n_l = np.max([highest_orders(o) for o in orders], axis=0)
    area = np.abs(edges[..., 0, 0] * edges[..., 1, 1] - edges[..., 0, 1] * edges[..., 1, 0])
    out = np.zeros((*area.shape, n_k + 1, 2 * n_l + 1))
    for kind, (k, l) in enumerate(orders):
        out[:, kind, 0, n_l] = area[:, kind]
        waves = np.sinc(edges[:, kind] @ orders[kind])  # (B, edge, harmonic)
        out[:, kind, k, l + n_l] = 2 * area[:, kind, None] * waves[:, 0] * waves[:, 1]
    return out


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _cell(scene: SceneRecord, method: ExposureMethod) -> Cell:
    if not scene.shows_pattern:
        return cell_of_whole_pixels(method.taps)
    kinds, every = _kinds(scene)
    subpixels = [(s.channel, s.centre, kind) for kind, s in every]
    periods = [s.period for s in kinds]
    return lower_cell(subpixels, periods, _orders(scene, method), method.taps // 2)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _kinds(scene: SceneRecord) -> tuple[list[Subpixel], list[tuple[int, Subpixel]]]:
    """Return a subpixel of each kind of a layout, and all of them with their kind, those of one
    kind and height together: kernels compute once what neighbours in this order share."""
    kinds: dict[tuple, tuple[int, Subpixel]] = {}
    subpixels = []
    for s in scene.panel.cell.all():
        kind, _ = kinds.setdefault((s.across, s.down, s.period), (len(kinds), s))
        subpixels.append((kind, s))
    subpixels.sort(key=lambda one: (one[0], one[1].centre[1]))
    return [s for _, s in kinds.values()], subpixels


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _orders(scene: SceneRecord, method: ExposureMethod) -> list[np.ndarray]:
    """Return the k and l of each kind of subpixel's harmonics, (2, n) int64."""
    layout, of_kinds = scene.panel.cell, []
    harmonics = np.array(method.harmonics, np.int64).reshape(-1, 2).T
    for subpixel in _kinds(scene)[0]:
        k, l, has = own_orders(subpixel, layout, *harmonics)
        of_kinds.append(np.stack([k, l])[:, has].astype(np.int64))
    return of_kinds
