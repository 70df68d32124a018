"""From a Shot to what the kernels are told."""

from __future__ import annotations

import numpy as np
import torch

from moireaug.effects import prefilter
from moireaug.effects.demosaic import DEMOSAICS
from moireaug.effects.flicker import flicker
from moireaug.engine import lowering
from moireaug.engine.record import LANES, Development, Exposure, Point
from moireaug.engine.resampling import lower_resize, lower_stencil
from moireaug.geometry.sensor import CFA, SampledPixels
from moireaug.panel.fourier import emitting_share, mean_light
from moireaug.scene.layout import as_layout
from moireaug.scene.shot import REACH, ShotRecord


def exposure_of(shot: ShotRecord, *, decoded: bool) -> Exposure:
    """Return the exposure of a shot; `decoded` pictures hold the light that its decoding and prefilter make of them."""
    rows, cols = (pixels.positions() for pixels in shot.sampled_pixels())
    cell, coefficients, widths, skew = _cell_of(shot)
    plan = shot.plan
    bands = torch.empty(len(shot), 0, dtype=torch.float64)
    if "flicker" in plan:
        panel, sensor = shot.panel, shot.sensor
        bands = flicker(rows / shot.size[0], panel.pwm, panel.duty, panel.phase, sensor.shutter, sensor.readout)
    return Exposure(
        size=shot.size,
        cameras=_cameras_of(shot),
        cell=cell,
        coefficients=coefficients,
        widths=widths,
        skew=skew,
        sites=lowering.lower_sites(rows, cols, shot.size, CFA[shot.scene.sensor.cfa]),
        flicker=bands.contiguous().numpy(),
        keys=lowering.lower_keys(shot.seed),
        noise="noise" in plan,
        coded="decode" in plan and not decoded,
        share=np.zeros(len(shot), np.float32) if decoded else _shares_of(shot),
        dark=not shot.scene.develop.registered,
        clips=any(effect.name == "full_well" for effect in plan.exposing),
        point=_point_of(shot) if plan.exposure == "point" else None,
    )


def _shares_of(shot: ShotRecord) -> np.ndarray:
    """The share of a picture pixel's light that comes from its neighbours."""
    if "prefilter" not in shot.plan:
        return np.zeros(len(shot), np.float32)
    return prefilter.share_at_centre(shot).float().numpy()


def _point_of(shot: ShotRecord) -> Point:
    layout, (width, height) = as_layout(shot.scene.panel.layout), emitting_share(shot.panel)
    corners = [subpixel.corners() for subpixel in layout.all()]
    rectangles = [(*c[0], *c[2]) for c in corners]
    return Point(np.array(rectangles, np.float64), layout.raster, (width * height).numpy())


def development_of(shot: ShotRecord) -> Development:
    """Return the development of a shot, all but denoising and JPEG."""
    plan, sensor, how = shot.plan, shot.scene.sensor, shot.scene.develop
    rows, cols = shot.sampled_pixels()
    mosaic, one = sensor.cfa == "rggb", torch.ones(len(shot), dtype=torch.float64)
    demosaic, reach = None, 0
    if mosaic:
        demosaic, reach = DEMOSAICS[how.demosaic], REACH[how.demosaic]
    gains = torch.stack([one, one, one], 1)
    if "balance" in plan:
        gains = torch.stack([shot.develop.red, one, shot.develop.blue], 1)
    return Development(
        size=shot.size,
        mosaic=mosaic,
        stencil=lower_stencil(demosaic, len(cols.index) // 2, LANES),
        rows=_resize_of(rows, how.resize, reach, 1),
        cols=_resize_of(cols, how.resize, reach, 2 if mosaic else 1),
        saturates="saturate" in plan,
        levels=np.float32(2**sensor.bits - 1 if "bits" in plan else 0),
        gains=gains.float().numpy(),
        coded="encode" in plan,
        brighten=(shot.develop.brighten if "brighten" in plan else 0 * one).float().numpy(),
        views=lowering.lower_views(shot.matrix(), shot.size) if "register" in plan else None,
        lens=torch.stack(shot.distortion or (0 * one, 0 * one), 1).numpy(),
    )


def _resize_of(pixels: SampledPixels, how: str, reach: int, parity: int):
    whole = pixels.kept.stop - pixels.kept.start
    return lower_resize(len(pixels.index), pixels.size, whole, how, pixels.step, pixels.lead, reach, parity, LANES)


def _cameras_of(shot: ShotRecord) -> list:
    plan, zero = shot.plan, torch.zeros(len(shot), dtype=torch.float64)
    k1, k2 = shot.distortion or (zero, zero)
    noisy = "noise" in plan
    return lowering.lower_cameras(
        torch.linalg.inv(shot.matrix()),
        shot.size,
        tuple(pixels.scale for pixels in shot.sampled_pixels()),
        k1=k1,
        k2=k2,
        alpha=shot.panel.scale,
        fill=shot.sensor.fill,
        blur=shot.lens.blur,
        olpf=shot.lens.olpf,
        gain=shot.sensor.gain if "gain" in plan else zero + 1,
        read=shot.sensor.read_noise if noisy else zero,
        shot=shot.sensor.shot_noise if noisy else zero,
        vignetting=shot.lens.vignetting if "vignetting" in plan else zero,
    )


def _cell_of(shot: ShotRecord) -> tuple:
    """The unit cell, and the coefficients, widths and skews of its kinds of subpixel."""
    layout, method = as_layout(shot.scene.panel.layout), shot.plan.method
    width, height = emitting_share(shot.panel)
    if method.name == "mean":
        subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
        cell = lowering.lower_cell(subpixels, (1, 1), method.taps // 2)
        light = torch.stack([mean_light(layout, channel, width, height) for channel in range(3)], 1)
        widths = torch.ones(len(shot), 3, 2, dtype=torch.float64)
        return cell, light[:, :, None, None].contiguous().numpy(), widths.numpy(), torch.zeros_like(widths).numpy()
    kinds = list(dict.fromkeys((s.across, s.down) for s in layout.all()))
    edges = torch.tensor(kinds, dtype=torch.float64)
    shares = torch.stack([width, height], 1)[:, None, :, None]  # of the edges across and down
    subpixels = [(s.channel, s.centre, kinds.index((s.across, s.down))) for s in layout.all()]
    cell = lowering.lower_cell(subpixels, layout.period, method.taps // 2)
    return cell, *lowering.lower_shapes(edges * shares, layout.period, method.harmonics)
