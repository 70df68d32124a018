"""From a Shot to the record of its development. What depends only on scene and size is cached, as
in `exposure`; of the last shot, the whole record is."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import torch

from moireaug.camera.effects.demosaic import DEMOSAICS
from moireaug.camera.effects.detail import kernel_sigma, kernel_size, max_photo_sigma
from moireaug.camera.effects.tone import colour_matrix
from moireaug.engine.lower.development_records import (
    Codes,
    Detail,
    Development,
    Registration,
    Resize,
)
from moireaug.engine.lower.resampling import demosaic_weights, lower_means, lower_resize
from moireaug.scene.develop import DEMOSAIC_REACH
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.geometry.lattice import SampledPixels
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord, sampled_rows_and_columns
from moireaug.scene.shot_geometry import HostGeometry

# a Development, and what it was made of
_last: tuple[SceneRecord, Any, Development] | None = None


def lower_development(
    shot: ShotRecord, effects: tuple[str, ...], geometry: HostGeometry | None = None
) -> Development:
    """Return a shot's Development. Made once for equal shots in a row, as of an attack's steps.

    effects: `Execution.engine_effects`; if they end before the resize, so do photos, at the codes
        of the pixels that were read.
    geometry: of the shot, if it is at hand.
    """
    global _last
    geometry = geometry or shot.host_geometry()
    last, values = _last, (shot.size, shot.whole_size, effects, geometry.table.tobytes())
    if last is None or last[0] is not shot.scene or last[1] != values:
        _last = last = shot.scene, values, _development_of(shot, effects, geometry)
    return last[2]


def _development_of(
    shot: ShotRecord, effects: tuple[str, ...], geometry: HostGeometry
) -> Development:
    sensor, drawn = shot.scene.sensor, geometry.numbers()
    filters_detail = "chroma_blur" in effects or "sharpen" in effects
    # of a plan without a resize, photos have the pixels that were read
    resizes = "resize" in effects or "resize" not in shot.plan
    every = shot.plan.needs_every_pixel
    demosaic, rows, cols = _resampling(
        shot.scene, shot.size, needs_every_pixel=every, whole=filters_detail or not resizes
    )
    if "colour_matrix" in effects:
        matrix = colour_matrix(drawn["sensor.crosstalk"], drawn["develop.saturation"])
    else:
        matrix = np.eye(3)[None].repeat(len(shot), 0)
    if "balance" in effects:
        gains = [drawn["develop.red"], np.ones(len(shot)), drawn["develop.blue"]]
        matrix = matrix * np.stack(gains, 1)[:, None, :]
    shoulder, contrast, brighten = np.zeros((3, len(shot)), np.float32)
    if "tone_curve" in effects:
        shoulder[:] = drawn["develop.shoulder"]
        contrast[:] = drawn["develop.contrast"]
    if "brighten" in effects:
        brighten[:] = drawn["develop.brighten"]
    detail = _detail_of(shot, effects, geometry)
    levels = np.float32(0)
    if "bits" in effects and sensor.bits is not None:
        levels = np.float32(2**sensor.bits - 1)
    codes = Codes(
        planes=shot.raw_shape()[1],
        mosaic=shot.scene.filter_cell == "rggb",
        demosaic=demosaic,
        rows=rows,
        cols=cols,
        saturates="saturate" in effects,
        levels=levels,
        matrix=matrix.astype(np.float32),
        mixes="colour_matrix" in effects,
        coded="encode" in effects,
        toned="tone_curve" in effects,
        shoulder=shoulder,
        contrast=contrast,
        brighten=brighten,
    )
    registers = "register" in effects
    registration = Registration(np.empty((0, 3, 3)), np.empty((0, 2)))
    if registers:
        registration = Registration(geometry.homography, np.stack(geometry.lens_distortion, 1))
    return Development(
        size=shot.size if resizes else detail.size,
        codes=codes,
        filters_detail=filters_detail,
        detail=detail,
        registers=registers,
        registration=registration,
    )


def _detail_of(shot: ShotRecord, effects: tuple[str, ...], geometry: HostGeometry) -> Detail:
    """Return a shot's Detail; neutral values for effects that kernels do not compute."""
    how, drawn = shot.scene.develop, geometry.numbers()
    rows, cols = shot.sampled_pixels()
    amount, chroma_size, sharp_size = np.zeros(len(shot), np.float32), 1, 1
    chroma, sharp = drawn["develop.chroma_blur"], drawn["develop.sharpen_radius"]
    if "chroma_blur" in effects:
        chroma_size = kernel_size(max_photo_sigma(shot.scene, "chroma_blur", shot.whole_size))
    if "sharpen" in effects:
        amount[:] = drawn["develop.sharpen"]
        sharp_size = kernel_size(max_photo_sigma(shot.scene, "sharpen_radius", shot.whole_size))
    if shot.scene.is_binned and max(chroma_size, sharp_size) > 1:
        longest = max(shot.whole_size)
        both = np.minimum(np.stack([chroma, sharp]) / geometry.bin_scale, longest)
        chroma, sharp = kernel_sigma(torch.from_numpy(both)).numpy()
    down, across = (lower_resize(p.count, p.size, p.count, how.resize) for p in (rows, cols))
    return Detail(
        (rows.count, cols.count),
        down,
        across,
        chroma,
        chroma_size,
        sharp,
        sharp_size,
        amount,
    )


@functools.lru_cache(maxsize=MAX_CACHED_SCENES)
def _resampling(
    scene: SceneRecord, size: tuple[int, int], *, needs_every_pixel: bool, whole: bool
) -> tuple[np.ndarray, Resize, Resize]:
    """Return the demosaic's weights, and the resize along rows and columns.

    needs_every_pixel: see `Plan`. whole: the pixels that were read are not resized.
    """
    how, mosaic = scene.develop, scene.filter_cell == "rggb"
    rows, cols = sampled_rows_and_columns(scene, size, needs_every_pixel=needs_every_pixel)
    demosaic, reach = np.zeros((4, 3, 4, 3, 3), np.float32), 0
    if mosaic:
        demosaic, reach = demosaic_weights(DEMOSAICS[how.demosaic]), DEMOSAIC_REACH[how.demosaic]
    return (
        demosaic,
        _resize(rows, how.resize, reach, whole=whole),
        _resize(cols, how.resize, reach, whole=whole),
    )


def _resize(pixels: SampledPixels, how: str, reach: int, *, whole: bool) -> Resize:
    read, count = len(pixels.index), pixels.count
    if whole:
        return lower_means(read, count, 1, pixels.lead, 0)
    if how == "point" and pixels.step > 1:
        return lower_means(read, pixels.size, pixels.step, pixels.lead, reach)
    return lower_resize(read, pixels.size, count, how)
