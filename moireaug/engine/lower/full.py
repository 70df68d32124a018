"""From a Shot to how the pixels of a full reading see the panel."""

from __future__ import annotations

import functools

import numpy as np

from moireaug.camera.panel.fourier import emitting_share, mean_light_of, own_orders
from moireaug.engine.lower.cameras import camera_fields, from_corner, lower_cameras
from moireaug.engine.lower.cell import (
    cell_of_whole_pixels,
    highest_orders,
    lower_cell,
)
from moireaug.engine.lower.exposure_records import Cell, FullView, PointView
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.exposure_method import ExposureMethod
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry
from moireaug.scene.subpixel import Subpixel


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
    rectangles = np.array([subpixel.box() for subpixel in _subpixels(scene)], np.float64)
    return PointView(rectangles, scene.panel.cell.raster, width * height)


def full_view(geometry: HostGeometry, cameras: np.ndarray) -> FullView:
    """Return a shot's FullView; cameras: of its sensor pixels."""
    scene = geometry.scene
    if not scene.shows_pattern:
        widths = np.ones((len(cameras), 3, 2))
        mean = mean_light_of(geometry)[:, :, None, None]
        return FullView(cameras, mean, widths, np.zeros_like(widths))
    width, height = emitting_share(geometry.panel)
    kinds = _kinds(scene).values()
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
    subpixels = [(s.channel, s.centre, _kind(scene, s)) for s in _subpixels(scene)]
    periods = [s.period for s in _kinds(scene).values()]
    return lower_cell(subpixels, periods, _orders(scene, method), method.taps // 2)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _kinds(scene: SceneRecord) -> dict[tuple, Subpixel]:
    """Return the shapes and periods of a layout's subpixels, and one subpixel of each."""
    kinds: dict[tuple, Subpixel] = {}
    for subpixel in scene.panel.cell.all():
        kinds.setdefault(_shape(subpixel), subpixel)
    return kinds


def _shape(subpixel: Subpixel) -> tuple:
    return subpixel.across, subpixel.down, subpixel.period


def _kind(scene: SceneRecord, subpixel: Subpixel) -> int:
    return list(_kinds(scene)).index(_shape(subpixel))


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _orders(scene: SceneRecord, method: ExposureMethod) -> list[np.ndarray]:
    """Return the k and l of each kind of subpixel's harmonics, (2, n) int64."""
    layout, of_kinds = scene.panel.cell, []
    harmonics = np.array(method.harmonics, np.int64).reshape(-1, 2).T
    for subpixel in _kinds(scene).values():
        k, l, has = own_orders(subpixel, layout, *harmonics)
        of_kinds.append(np.stack([k, l])[:, has].astype(np.int64))
    return of_kinds


def _subpixels(scene: SceneRecord) -> list[Subpixel]:
    """Return a layout's subpixels, those of one kind and height together: kernels compute once what
    neighbours in this order share."""
    subpixels = scene.panel.cell.all()
    return sorted(subpixels, key=lambda s: (_kind(scene, s), s.centre[1]))
