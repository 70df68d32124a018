"""From a Shot to the kernels' records. What depends only on the scene and the size is cached; the
rest changes with every photo, and is mostly computed in numpy."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
import torch

from moireaug.effects import prefilter
from moireaug.effects.demosaic import DEMOSAICS
from moireaug.effects.detail import kernel_size
from moireaug.effects.display import white_readings
from moireaug.effects.flicker import flicker
from moireaug.effects.tone import colour_matrix
from moireaug.engine import lowering, pose
from moireaug.engine.record import (
    LANES,
    Cell,
    Codes,
    Detail,
    Development,
    Exposure,
    Point,
    Registration,
    Resize,
    Sites,
    Stencil,
)
from moireaug.engine.resampling import lower_resize, lower_stencil
from moireaug.exposure.filters import crosstalk_matrix
from moireaug.geometry.sensor import CFA, SampledPixels
from moireaug.panel.fourier import emitting_share, mean_light
from moireaug.scene.layout import as_layout
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import REACH, ShotRecord, sampled_by

if TYPE_CHECKING:
    from moireaug.scene.scene import Scene

KEPT = 64  # scenes and sizes whose tables are cached


def exposure_of(shot: ShotRecord, *, decoded: bool) -> Exposure:
    """Return a shot's Exposure.

    decoded: the pictures have already been decoded, raised to the black level and prefiltered.
    """
    plan, drawn = shot.plan, _numbers_of(shot)
    share = np.zeros(len(shot), np.float32)
    if "prefilter" in plan and not decoded:
        share = prefilter.share_at_centre(shot).detach().float().numpy()
    coefficients, widths, skew = _shapes_of(shot)
    black = np.zeros(len(shot), np.float32)
    if "black_level" in plan and not decoded:
        black[:] = drawn["panel.black"]
    filters = np.eye(3)[None].repeat(len(shot), 0)
    if "crosstalk" in plan:
        filters = crosstalk_matrix(torch.from_numpy(drawn["sensor.crosstalk"])).numpy()
    return Exposure(
        size=shot.size,
        cameras=_cameras_of(shot, drawn),
        filters=filters,
        white=_white_of(shot),
        black=black,
        cell=_cell(shot.scene),
        coefficients=coefficients,
        widths=widths,
        skew=skew,
        sites=_sites(shot.scene, shot.size),
        flicker=_flicker_of(shot),
        seeds=shot.seed.numpy(),
        noise="noise" in plan,
        coded="decode" in plan and not decoded,
        share=share,
        dark=not shot.scene.develop.registered,
        clips=any(effect.name == "full_well" for effect in plan.exposing),
        point=_point_of(shot) if plan.exposure == "point" else None,
    )


def development_of(shot: ShotRecord) -> Development:
    """Return a shot's Development, without `Plan.finishing`; if it is denoised, it ends at the
    codes of every sensor pixel."""
    plan, sensor, drawn = shot.plan, shot.scene.sensor, _numbers_of(shot)
    stencil, rows, cols = _resampling(shot.scene, shot.size)
    matrix = np.eye(3)[None].repeat(len(shot), 0)
    if "colour_matrix" in plan:
        mixed = [torch.from_numpy(drawn[k]) for k in ("sensor.crosstalk", "develop.saturation")]
        matrix = colour_matrix(*mixed).numpy()
    if "balance" in plan:
        gains = [drawn["develop.red"], np.ones(len(shot)), drawn["develop.blue"]]
        matrix = matrix * np.stack(gains, 1)[:, None, :]
    shoulder, contrast, brighten = np.zeros((3, len(shot)), np.float32)
    if "tone_curve" in plan:
        shoulder[:] = drawn["develop.shoulder"]
        contrast[:] = drawn["develop.contrast"]
    if "brighten" in plan:
        brighten[:] = drawn["develop.brighten"]
    denoises, detail = "denoise" in plan, _detail_of(shot, drawn)
    levels = np.float32(0)
    if "bits" in plan and sensor.bits is not None:
        levels = np.float32(2**sensor.bits - 1)
    codes = Codes(
        mosaic=sensor.cfa == "rggb",
        stencil=stencil,
        rows=rows,
        cols=cols,
        saturates="saturate" in plan,
        levels=levels,
        matrix=matrix.astype(np.float32),
        mixes="colour_matrix" in plan,
        coded="encode" in plan,
        toned="tone_curve" in plan,
        shoulder=shoulder,
        contrast=contrast,
        brighten=brighten,
    )
    return Development(
        size=detail.size if denoises else shot.size,
        codes=codes,
        finishes=("chroma_blur" in plan or "sharpen" in plan) and not denoises,
        detail=detail,
        registers="register" in plan and not denoises,
        registration=_registration_of(shot, drawn),
    )


def _registration_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> Registration:
    views, lens = np.empty((0, 3, 3)), np.empty((0, 2))
    if "register" in shot.plan:
        views = _homography_of(shot, drawn)
        lens = np.stack(_distortion_of(shot, drawn), 1)
    return Registration(views, lens)


def _detail_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> Detail:
    """Return a shot's Detail; neutral values for effects that are not planned."""
    plan, how = shot.plan, shot.scene.develop
    rows, cols = shot.sampled_pixels()
    amount, chroma_size, sharp_size = np.zeros(len(shot), np.float32), 1, 1
    if "chroma_blur" in plan:
        chroma_size = kernel_size(how.chroma_blur)
    if "sharpen" in plan:
        amount[:] = drawn["develop.sharpen"]
        sharp_size = kernel_size(how.sharpen_radius)
    return Detail(
        (_kept(rows), _kept(cols)),
        _resize_of_photo(rows, how.resize),
        _resize_of_photo(cols, how.resize),
        drawn["develop.chroma_blur"],
        chroma_size,
        drawn["develop.sharpen_radius"],
        sharp_size,
        amount,
    )


def _numbers_of(shot: ShotRecord) -> dict[str, np.ndarray]:
    """Return the drawn numbers by name, "view.yaw", (B,) float64 each."""
    numbers = shot.numbers()
    rows = torch.stack(list(numbers.values())).detach().numpy()
    return dict(zip(numbers, rows, strict=True))


def _distortion_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    if "lens" not in shot.plan:
        return np.zeros(len(shot)), np.zeros(len(shot))
    return drawn["lens.k1"], drawn["lens.k2"]


def _homography_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> np.ndarray:
    """Return the homography from image to ideal photo coordinates, about the centres, (B, 3, 3)
    float64."""
    if shot.scene.view.pose != "camera":
        return pose.centred(shot.matrix().detach().numpy(), shot.size)
    return pose.camera_pose(drawn, shot.size, shot.scene.view.fit)


def _cameras_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> np.ndarray:
    plan, zero = shot.plan, np.zeros(len(shot))
    k1, k2 = _distortion_of(shot, drawn)
    noisy = "noise" in plan
    fields = {
        "k1": k1,
        "k2": k2,
        "alpha": drawn["panel.scale"],
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
    }
    rows, cols = shot.sampled_pixels()
    back = pose.inverse(_homography_of(shot, drawn), shot.size)
    return lowering.lower_cameras(back, shot.size, (rows.scale, cols.scale), fields)


def _shapes_of(shot: ShotRecord) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients, widths and skews of the cell's kinds of subpixel."""
    layout, method = as_layout(shot.scene.panel.layout), shot.plan.method
    width, height = (share.detach() for share in emitting_share(shot.panel))
    if method.name == "mean":
        light = torch.stack([mean_light(layout, channel, width, height) for channel in range(3)], 1)
        widths = np.ones((len(shot), 3, 2))
        return light[:, :, None, None].numpy(), widths, np.zeros_like(widths)
    edges = np.array(_kinds(shot.scene))
    shares = np.stack([width, height], 1)[:, None, :, None]  # of the edges across and down
    return lowering.lower_shapes(edges * shares, layout.period, method.harmonics)


def _point_of(shot: ShotRecord) -> Point:
    layout, (width, height) = as_layout(shot.scene.panel.layout), emitting_share(shot.panel)
    rectangles = []
    for subpixel in layout.all():
        corners = subpixel.corners()
        rectangles.append((*corners[0], *corners[2]))
    return Point(np.array(rectangles, np.float64), layout.raster, (width * height).detach().numpy())


def _white_of(shot: ShotRecord) -> np.ndarray:
    """Return what each plane reads of a white screen on average, (B, planes) float64; zeros without
    glare."""
    if "glare" not in shot.plan:
        return np.zeros((len(shot), shot.raw_shape()[1]))
    return white_readings(shot).detach().contiguous().numpy()


def _flicker_of(shot: ShotRecord) -> np.ndarray:
    """Return each sensor row's light relative to the mean, (B, rows) float64; (B, 0) without
    flicker."""
    if "flicker" not in shot.plan:
        return np.empty((len(shot), 0))
    drawn = shot.numbers()
    rows = shot.sampled_pixels()[0].positions() / shot.size[0]
    pulses = drawn["panel.pwm"], drawn["panel.duty"], drawn["panel.phase"]
    bands = flicker(rows, *pulses, drawn["sensor.shutter"], drawn["sensor.readout"])
    return bands.detach().contiguous().numpy()


@functools.lru_cache(maxsize=KEPT)
def _kinds(scene: SceneRecord) -> list:
    """Return the shapes of a layout's subpixels: their edges across and down."""
    return list(dict.fromkeys((s.across, s.down) for s in as_layout(scene.panel.layout).all()))


@functools.lru_cache(maxsize=KEPT)
def _cell(scene: Scene) -> Cell:
    layout, method = as_layout(scene.panel.layout), scene.plan().method
    if method.name == "mean":
        subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
        return lowering.lower_cell(subpixels, (1, 1), method.taps // 2)
    kinds = _kinds(scene)
    subpixels = [(s.channel, s.centre, kinds.index((s.across, s.down))) for s in layout.all()]
    return lowering.lower_cell(subpixels, layout.period, method.taps // 2)


@functools.lru_cache(maxsize=KEPT)
def _sites(scene: SceneRecord, size: tuple[int, int]) -> Sites:
    rows, cols = (pixels.positions().numpy() for pixels in sampled_by(scene, size))
    return lowering.lower_sites(rows, cols, size, CFA[scene.sensor.cfa])


@functools.lru_cache(maxsize=KEPT)
def _resampling(scene: Scene, size: tuple[int, int]) -> tuple[Stencil, Resize, Resize]:
    """Return the demosaic's stencil, and the resize along rows and columns."""
    how, mosaic = scene.develop, scene.sensor.cfa == "rggb"
    rows, cols = sampled_by(scene, size)
    demosaic, reach = None, 0
    if mosaic:
        demosaic, reach = DEMOSAICS[how.demosaic], REACH[how.demosaic]
    stencil = lower_stencil(demosaic, len(cols.index) // 2, LANES)
    whole = any(name in scene.plan() for name in ("denoise", "chroma_blur", "sharpen"))
    return (
        stencil,
        _resize(rows, how.resize, reach, 1, whole=whole),
        _resize(cols, how.resize, reach, 2 if mosaic else 1, whole=whole),
    )


def _kept(pixels: SampledPixels) -> int:
    return pixels.kept.stop - pixels.kept.start


def _resize_of_photo(pixels: SampledPixels, how: str) -> Resize:
    kept = _kept(pixels)
    return lower_resize(kept, pixels.size, kept, how, 0, 0, 0, 1, LANES)


def _resize(pixels: SampledPixels, how: str, reach: int, parity: int, *, whole: bool) -> Resize:
    read, kept = len(pixels.index), _kept(pixels)
    if whole:
        return lower_resize(read, kept, kept, "area", 0, 0, 0, parity, LANES)
    return lower_resize(
        read, pixels.size, kept, how, pixels.step, pixels.lead, reach, parity, LANES
    )
