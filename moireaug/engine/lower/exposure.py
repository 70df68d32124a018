"""From a Shot to the record of its exposure. What depends only on the scene and the size is cached;
the rest changes with every photo, and is mostly computed in numpy."""

from __future__ import annotations

import functools
import math

import numpy as np
import torch

from moireaug.camera.effects import prefilter, random_numbers
from moireaug.camera.effects.light import light_of_rows, white_readings
from moireaug.camera.exposure.filters import filters_of
from moireaug.engine.lower.binned import binned_view
from moireaug.engine.lower.budget import ErrorBudget
from moireaug.engine.lower.exposure_records import Camera, Exposure, PanelView, Sites
from moireaug.engine.lower.full import cameras_and_cell, full_view, point_view
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.fields import bounds
from moireaug.scene.geometry.lattice import CFA
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord, sampled_rows_and_columns
from moireaug.scene.shot_geometry import HostGeometry

BANDS_PER_CHANGE = 64  # of a row's light by its mean
MIN_BANDS_PER_ROW, MAX_BANDS_PER_ROW = 16, 64


def lower_exposure(
    shot: ShotRecord, geometry: HostGeometry | None = None, *, decoded: bool, exactness: int = 1
) -> tuple[Exposure, PanelView]:
    """Return a shot's Exposure, and how its pixels see the panel.

    Args:
        geometry: of the shot, if it is at hand.
        decoded: the pictures have already been decoded, raised to the black level and prefiltered.
        exactness: by how much the errors of the pattern are smaller than the scene's tolerance
            asks for.
    """
    geometry = geometry or shot.host_geometry()
    plan, drawn = shot.plan, geometry.numbers()
    view: PanelView
    if shot.scene.is_binned:
        cameras, cell, view = binned_view(shot, geometry)
    else:
        cameras, cell = cameras_and_cell(shot, geometry)
        view = point_view(geometry)
        if plan.exposure != "point":
            view = full_view(geometry, cameras)
    # of one layout, as kernels are compiled for each
    filters = np.ascontiguousarray(filters_of(geometry))
    black, share = np.zeros((2, len(shot)), np.float32)
    if "black_level" in plan and not decoded:
        black[:] = drawn["panel.black"]
    # a larger variance is one for each place, and 0 in images that are not decoded before
    is_even = plan.prefilter_variance <= prefilter.MAX_NEIGHBOUR_VARIANCE
    if "prefilter" in plan and is_even and not decoded:
        share[:] = prefilter.neighbour_share(shot).detach().float().numpy()
    budget = ErrorBudget.of(shot.scene.tolerance, exactness)
    if not shot.scene.is_binned:  # full readings err less, and take longer
        budget = budget._replace(weight_log_scale=2 * budget.weight_log_scale)
    exposure = Exposure(
        size=shot.size,
        cameras=cameras,
        filters=filters,
        white=_white_of(geometry),
        black=black,
        cell=cell,
        sites=_sites(shot.scene, shot.size, needs_every_pixel=shot.plan.needs_every_pixel),
        flicker=_flicker_of(shot, cameras, exactness),
        keys=torch.stack(random_numbers.keys(shot.seed), 1).numpy(),
        noisy="noise" in plan,
        coded="decode" in plan and not decoded,
        neighbour_share=share,
        dark_around=shot.is_dark_around,
        clips="clip_reading" in plan,
        # where a weight is linear between two phases, its slope errs the most
        budget=budget._replace(phase_error=budget.phase_error / exactness),
    )
    return exposure, view


def _white_of(geometry: HostGeometry) -> np.ndarray:
    """Return what each plane reads of a white screen on average, (B, planes) float64; zeros without
    glare, for which alone it is read."""
    white = np.ascontiguousarray(white_readings(geometry))
    return white if "glare" in geometry.plan else np.zeros_like(white)


def _flicker_of(shot: ShotRecord, cameras: np.ndarray, exactness: int) -> np.ndarray:
    """Return each sensor row's light relative to the mean, or of a binned reading, that at several
    bands of each photo row, (B, rows) float64; (B, 0) without flicker."""
    if "flicker" not in shot.plan:
        return np.empty((len(shot), 0))
    rows = shot.sampled_pixels()[0].positions()
    if shot.scene.is_binned:
        # what is linear in between errs by the square of their distance
        bands = math.ceil(_bands_per_row(shot.scene, shot.size[0]) * exactness**0.5)
        count = shot.size[0] * bands
        part = torch.arange(count + 2, dtype=torch.float64, device="cpu") / count
        fields = {name: cameras[:, i, None] for i, name in enumerate(Camera._fields)}
        top = fields["pulses_top"] + fields["photo_height"] / 2
        rows = torch.from_numpy(top) + part * torch.from_numpy(fields["pulses_height"])
    return light_of_rows(rows, shot).detach().contiguous().numpy()


def _bands_per_row(scene: SceneRecord, height: int) -> int:
    """Return in how many bands of a photo row kernels take the flicker as linear: the more, the
    faster a row's light may change. The scene decides, so that an image is read the same in any
    batch."""
    exposed = bounds(scene.panel.duty)[0] * max(bounds(scene.sensor.shutter)[0], 1e-9)
    change = bounds(scene.sensor.readout)[1] / (height * exposed)  # in a row at most
    return math.ceil(min(max(BANDS_PER_CHANGE * change, MIN_BANDS_PER_ROW), MAX_BANDS_PER_ROW))


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _sites(scene: SceneRecord, size: tuple[int, int], *, needs_every_pixel: bool) -> Sites:
    pixels = sampled_rows_and_columns(scene, size, needs_every_pixel=needs_every_pixel)
    rows, cols = (axis.positions().numpy() for axis in pixels)
    # (row, column, channels) of each site of a cell, in the planes' order
    cfa = CFA[scene.filter_cell]
    planes = [(r, c, channel) for r, c, channels in cfa for channel in channels]
    row, col, channel = (np.array(values, np.int64) for values in zip(*planes, strict=True))
    step = math.isqrt(len(cfa))
    return Sites(rows - size[0] / 2, cols - size[1] / 2, step, row, col, channel)
