"""From a Shot to how the pixels of a full reading see the panel."""

from __future__ import annotations

import functools

import numpy as np

from moireaug.engine.lower import pose
from moireaug.engine.lower.cameras import camera_fields, lower_cameras
from moireaug.engine.lower.cell import (
    PanelView,
    Shapes,
    cell_of_whole_pixels,
    lower_cell,
    lower_shapes,
    mean_light_of,
)
from moireaug.engine.lower.exposure_records import Cell, Point
from moireaug.engine.lower.numbers import MAX_CACHED_SCENES, panel_scale_of
from moireaug.exposure.base import ExposureMethod
from moireaug.panel.fourier import emitting_share, own_orders
from moireaug.scene.layout import as_layout
from moireaug.scene.record import SceneRecord
from moireaug.scene.subpixel import Subpixel
from moireaug.shot import ShotRecord


def full_view(shot: ShotRecord, drawn: dict[str, np.ndarray], inverse: np.ndarray) -> PanelView:
    """Return a shot's PanelView; inverse: (B, 3, 3), from ideal photo to image coordinates, both
    about the centre."""
    rows, cols = shot.sampled_pixels()
    fields = camera_fields(shot, drawn) | {"alpha": panel_scale_of(shot, drawn)}
    back = pose.from_corner(inverse, shot.size)
    cameras = lower_cameras(back, (rows.scale, cols.scale), fields)
    return PanelView(cameras, cameras, _cell(shot.scene, shot.plan.method), _shapes_of(shot))


def point_of(shot: ShotRecord) -> Point:
    """Return the Point of a shot whose exposure is "point"."""
    layout, (width, height) = as_layout(shot.scene.panel.layout), emitting_share(shot.panel)
    rectangles = [subpixel.box() for subpixel in _subpixels(shot.scene)]
    return Point(np.array(rectangles, np.float64), layout.raster, (width * height).detach().numpy())


def _shapes_of(shot: ShotRecord) -> Shapes:
    if shot.plan.method.name == "mean":
        widths = np.ones((len(shot), 3, 2))
        return Shapes(mean_light_of(shot)[:, :, None, None], widths, np.zeros_like(widths))
    width, height = (share.detach() for share in emitting_share(shot.panel))
    kinds = _kinds(shot.scene).values()
    edges = np.array([(s.across, s.down) for s in kinds])
    shares = np.stack([width, height], 1)[:, None, :, None]  # of the edges across and down
    periods = [s.period for s in kinds]
    return lower_shapes(edges * shares, periods, _orders(shot.scene, shot.plan.method))


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _cell(scene: SceneRecord, method: ExposureMethod) -> Cell:
    if method.name == "mean":
        return cell_of_whole_pixels(method.taps)
    subpixels = [(s.channel, s.centre, _kind(scene, s)) for s in _subpixels(scene)]
    periods = [s.period for s in _kinds(scene).values()]
    return lower_cell(subpixels, periods, _orders(scene, method), method.taps // 2)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _kinds(scene: SceneRecord) -> dict[tuple, Subpixel]:
    """Return the shapes and periods of a layout's subpixels, and one subpixel of each."""
    kinds: dict[tuple, Subpixel] = {}
    for subpixel in as_layout(scene.panel.layout).all():
        kinds.setdefault(_shape(subpixel), subpixel)
    return kinds


def _shape(subpixel: Subpixel) -> tuple:
    return subpixel.across, subpixel.down, subpixel.period


def _kind(scene: SceneRecord, subpixel: Subpixel) -> int:
    return list(_kinds(scene)).index(_shape(subpixel))


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _orders(scene: SceneRecord, method: ExposureMethod) -> list[np.ndarray]:
    """Return the k and l of each kind of subpixel's harmonics, (2, n) int64."""
    layout, of_kinds = as_layout(scene.panel.layout), []
    harmonics = np.array(method.harmonics, np.int64).reshape(-1, 2).T
    for subpixel in _kinds(scene).values():
        k, l, has = own_orders(subpixel, layout, *harmonics)
        of_kinds.append(np.stack([k, l])[:, has].astype(np.int64))
    return of_kinds


def _subpixels(scene: SceneRecord) -> list[Subpixel]:
    """Return a layout's subpixels, those of one kind and height together: kernels compute once what
    neighbours in this order share."""
    subpixels = as_layout(scene.panel.layout).all()
    return sorted(subpixels, key=lambda s: (_kind(scene, s), s.centre[1]))
