"""From a Shot to the record of its exposure. What depends only on the scene and the size is cached;
the rest changes with every photo, and is mostly computed in numpy."""

from __future__ import annotations

import functools

import numpy as np
import torch

from moireaug.effects import prefilter
from moireaug.effects.flicker import BANDS_PER_ROW, light_of_rows
from moireaug.engine import lowering, pose
from moireaug.engine.budget import ErrorBudget
from moireaug.engine.exposure_records import Beats, Cell, Exposure, Point, Sites
from moireaug.engine.shot_binned import (
    bin_scales,
    cell_in_bins,
    lower_beats,
    lower_bin_cameras,
    shapes_in_bins,
)
from moireaug.engine.shot_numbers import (
    MAX_CACHED_SCENES,
    distortion_of,
    homography_of,
    numbers_of,
    panel_scale_of,
)
from moireaug.exposure.base import ExposureMethod
from moireaug.exposure.bin_content import content_of
from moireaug.exposure.filters import filters_of
from moireaug.geometry.lattice import CFA
from moireaug.panel.fourier import emitting_share, mean_light, own_orders
from moireaug.scene.layout import as_layout
from moireaug.scene.record import SceneRecord
from moireaug.scene.subpixel import Subpixel
from moireaug.shot import ShotRecord, sampled_by


def lower_exposure(shot: ShotRecord, *, decoded: bool) -> tuple[Exposure, Beats | None]:
    """Return a shot's Exposure and, of a binned reading, its Beats.

    decoded: the pictures have already been decoded, raised to the black level and prefiltered.
    """
    plan, drawn = shot.plan, numbers_of(shot)
    homography, magnified = homography_of(shot, drawn)
    fields, inverse = _fields_of(shot, drawn), np.linalg.inv(homography)
    binned = shot.scene.is_binned
    if binned:
        with torch.no_grad():
            seen = content_of(shot)
        scales = bin_scales(shot, drawn, magnified)
        cameras, lenses, sensors = lower_bin_cameras(shot, inverse, fields, seen, scales)
        cell, (coefficients, widths, added_variance) = (
            cell_in_bins(plan.method.taps),
            shapes_in_bins(seen),
        )
    else:
        cell, (coefficients, widths, added_variance) = (
            _cell(shot.scene, plan.method),
            _shapes_of(shot),
        )
        rows, cols = shot.sampled_pixels()
        fields |= {"alpha": panel_scale_of(shot, drawn)}
        back = pose.from_corner(inverse, shot.size)
        cameras = lowering.lower_cameras(back, shot.size, (rows.scale, cols.scale), fields)
        lenses = cameras
    # of one layout, as kernels are compiled for each
    filters = np.ascontiguousarray(filters_of(shot).detach().numpy())
    black, share = np.zeros((2, len(shot)), np.float32)
    if "black_level" in plan and not decoded:
        black[:] = drawn["panel.black"]
    if "prefilter" in plan and not decoded:
        share[:] = prefilter.share_at_centre(shot).detach().float().numpy()
    exposure = Exposure(
        size=shot.size,
        cameras=cameras,
        lenses=lenses,
        filters=filters,
        white=_white_of(shot, filters),
        black=black,
        cell=cell,
        coefficients=coefficients,
        widths=widths,
        added_variance=added_variance,
        sites=_sites(shot.scene, shot.size),
        flicker=_flicker_of(shot),
        seeds=np.ascontiguousarray(shot.seed.numpy()),  # kernels are compiled for each layout
        noisy="noise" in plan,
        coded="decode" in plan and not decoded,
        neighbour_share=share,
        dark=not shot.scene.develop.registered,
        clips="full_well" in plan,
        budget=ErrorBudget.of(shot.scene.tolerance),
        point=_point_of(shot) if plan.exposure == "point" else None,
    )
    return exposure, lower_beats(shot, sensors, seen, scales) if binned else None


def _fields_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the fields of the cameras that `lowering.lower_cameras` takes."""
    plan, zero = shot.plan, np.zeros(len(shot))
    k1, k2 = distortion_of(shot, drawn)
    noisy = "noise" in plan
    return {
        "k1": k1,
        "k2": k2,
        "fill": drawn["sensor.fill"],
        "blur": drawn["lens.blur"],
        "olpf": drawn["lens.olpf"],
        "gain": drawn["sensor.gain"] if "gain" in plan else zero + 1,
        "read": drawn["sensor.read_noise"] if noisy else zero,
        "shot": drawn["sensor.shot_noise"] if noisy else zero,
        "vignetting": drawn["lens.vignetting"] if "vignetting" in plan else zero,
        "motion_x": drawn["lens.motion_x"],
        "motion_y": drawn["lens.motion_y"],
        "glare": drawn["panel.glare"] if "glare" in plan else zero,
        "glare_x": drawn["panel.glare_x"],
        "glare_y": drawn["panel.glare_y"],
        "rectified": zero,
    }


def _shapes_of(shot: ShotRecord) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients, widths and added variances of the cell's kinds of subpixel."""
    if shot.plan.method.name == "mean":
        widths = np.ones((len(shot), 3, 2))
        return _mean_light(shot)[:, :, None, None], widths, np.zeros_like(widths)
    width, height = (share.detach() for share in emitting_share(shot.panel))
    kinds = _kinds(shot.scene).values()
    edges = np.array([(s.across, s.down) for s in kinds])
    shares = np.stack([width, height], 1)[:, None, :, None]  # of the edges across and down
    periods = [s.period for s in kinds]
    return lowering.lower_shapes(edges * shares, periods, _orders(shot.scene, shot.plan.method))


def _point_of(shot: ShotRecord) -> Point:
    layout, (width, height) = as_layout(shot.scene.panel.layout), emitting_share(shot.panel)
    rectangles = [subpixel.box() for subpixel in _subpixels(shot.scene)]
    return Point(np.array(rectangles, np.float64), layout.raster, (width * height).detach().numpy())


def _white_of(shot: ShotRecord, filters: np.ndarray) -> np.ndarray:
    """Return what each plane reads of a white screen on average, (B, planes) float64, as
    `effects.display.white_readings` does; zeros without glare."""
    channel = _sites(shot.scene, shot.size).channel
    if "glare" not in shot.plan:
        return np.zeros((len(shot), len(channel)))
    light = _mean_light(shot)
    return np.ascontiguousarray((filters @ light[:, :, None])[:, channel, 0])


def _mean_light(shot: ShotRecord) -> np.ndarray:
    """Return the share of the panel's area that emits each colour, (B, 3) float64."""
    layout = as_layout(shot.scene.panel.layout)
    width, height = (share.detach().numpy() for share in emitting_share(shot.panel))
    return np.stack([mean_light(layout, channel, width, height) for channel in range(3)], 1)


def _flicker_of(shot: ShotRecord) -> np.ndarray:
    """Return each sensor row's light relative to the mean, or of a binned reading, that at every
    1 / BANDS_PER_ROW of a photo row, (B, rows) float64; (B, 0) without flicker."""
    if "flicker" not in shot.plan:
        return np.empty((len(shot), 0))
    rows = shot.sampled_pixels()[0].positions()
    if shot.scene.is_binned:
        bands = shot.size[0] * BANDS_PER_ROW
        rows = torch.arange(bands + 2, dtype=torch.float64, device="cpu") / BANDS_PER_ROW
    return light_of_rows(rows, shot).detach().contiguous().numpy()


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


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _cell(scene: SceneRecord, method: ExposureMethod) -> Cell:
    if method.name == "mean":
        subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
        none = np.empty((2, 0), np.int64)
        return lowering.lower_cell(subpixels, [(1, 1)] * 3, [none] * 3, method.taps // 2)
    subpixels = [(s.channel, s.centre, _kind(scene, s)) for s in _subpixels(scene)]
    periods = [s.period for s in _kinds(scene).values()]
    return lowering.lower_cell(subpixels, periods, _orders(scene, method), method.taps // 2)


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _sites(scene: SceneRecord, size: tuple[int, int]) -> Sites:
    rows, cols = (pixels.positions().numpy() for pixels in sampled_by(scene, size))
    return lowering.lower_sites(rows, cols, size, CFA[scene.cells])
