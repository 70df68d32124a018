"""From a Shot to the records of its binned reading; cached as in `shot_exposure`."""

from __future__ import annotations

import functools

import numpy as np
import torch

from moireaug.effects.sensor import averaged_pixels
from moireaug.engine import lowering
from moireaug.engine.exposure_records import Beats, Camera, Cell
from moireaug.exposure.bin_content import Content, content_of
from moireaug.panel.fourier import amplitudes_of, emitting_share, mean_light
from moireaug.scene.layout import as_layout
from moireaug.scene.shot import ShotRecord


def content_in_bins(shot: ShotRecord, alpha: np.ndarray, scale: np.ndarray) -> Content:
    """Return a shot's Content, given `shot.panel_scale` and `shot.sensor_scale`."""
    with torch.no_grad():
        return content_of(shot, torch.from_numpy(alpha), torch.from_numpy(scale))


def fields_in_bins(shot: ShotRecord, seen: Content, scale: np.ndarray) -> dict[str, np.ndarray]:
    """Return those fields of a Camera of photo pixels that differ from a sensor's."""
    optics = seen.optics
    fields = {
        "alpha": seen.scale,
        "fill": optics.fill,
        "blur": optics.blur,
        "olpf": optics.olpf,
        "motion_x": optics.motion_x,
        "motion_y": optics.motion_y,
    }
    if "noise" in shot.plan:
        root = averaged_pixels(shot, torch.from_numpy(scale)).sqrt()
        drawn = shot.numbers()
        fields["read"] = drawn["sensor.read_noise"] / root
        fields["shot"] = drawn["sensor.shot_noise"] / root
    return {name: values.detach().numpy() for name, values in fields.items()}


def shapes_in_bins(seen: Content) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients, widths and skews of `exposure_records.Exposure`: of pixels that emit
    all over."""
    width, hold = seen.width.detach().numpy(), seen.hold.detach().numpy()
    skew = np.repeat(hold, 6).reshape(-1, 3, 2)
    return np.ones((len(hold), 3, 1, 1)), np.ascontiguousarray(width), skew


@functools.lru_cache(maxsize=8)
def cell_in_bins(taps: int) -> Cell:
    """Return the Cell of a panel that shows one pixel of each colour, of which `taps` are looked at
    along each axis; its centres differ by image."""
    none = np.empty((2, 0), np.int64)
    subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
    cell = lowering.lower_cell(subpixels, [(1, 1)] * 3, [none] * 3, taps // 2)
    # none at the same height: centres differ
    return cell._replace(height=np.arange(3), row=np.arange(3))


def lower_beats(
    shot: ShotRecord, cameras: np.ndarray, seen: Content, alpha: np.ndarray, scale: np.ndarray
) -> Beats:
    """Return a shot's Beats.

    Args:
        cameras: of photo pixels; see `lowering.lower_cameras`.
    """
    layout, method = as_layout(shot.scene.panel.layout), shot.plan.method
    harmonics = np.array(method.harmonics, np.int64).reshape(-1, 2)
    lit = [share.detach() for share in emitting_share(shot.panel)]
    parts = [amplitudes_of(layout, channel, method.harmonics, shot.panel) for channel in range(3)]
    waves = np.stack([np.stack([t.detach().numpy() for t in wave], -1) for wave in parts])
    waves = np.ascontiguousarray(waves.transpose(2, 0, 1, 3))  # (B, 3, K, 2)
    mean = np.stack([mean_light(layout, c, *(t.numpy() for t in lit)) for c in range(3)], 1)
    centres = 0.5 + seen.shift.detach().numpy()
    return Beats(
        cameras=_sensor_cameras(cameras, shot, alpha, scale),
        scale=scale,
        ratio=np.ascontiguousarray(seen.ratio.detach().numpy()),
        centres=np.ascontiguousarray(centres),
        period=np.array(layout.period, np.int64),
        orders=harmonics,
        coefficients=waves.astype(np.float32),
        strength=np.ascontiguousarray(np.sqrt((waves**2).sum(-1)).max(1)),
        mean=mean,
        away=_noise_away(shot, scale),
        saturates="saturate" in shot.plan,
        bayer=shot.scene.cells == "binned",
    )


def _sensor_cameras(
    cameras: np.ndarray, shot: ShotRecord, alpha: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Return the cameras of sensor pixels from those of photo pixels."""
    lens, out = shot.lens, cameras.copy()
    own = {
        "alpha": alpha,
        "scale_u": scale,
        "scale_v": scale,
        "fill": shot.sensor.fill,
        "blur": lens.blur,
        "olpf": lens.olpf,
        "motion_x": lens.motion_x,
        "motion_y": lens.motion_y,
    }
    for name, values in own.items():
        numbers = values.detach().numpy() if isinstance(values, torch.Tensor) else values
        out[:, Camera._fields.index(name)] = numbers
    return out


def _share_away(shot: ShotRecord, scale: np.ndarray) -> np.ndarray:
    """Return the share of the variance of sensor pixels that is averaged away, (B,)."""
    return (1 - 1 / averaged_pixels(shot, torch.from_numpy(scale))).numpy()


def _noise_away(shot: ShotRecord, scale: np.ndarray) -> np.ndarray:
    """Return the variance of noise that is averaged away, (B, 2) float32, in the dark and what a
    reading of 1 adds; zeros without noise."""
    out = np.zeros((len(shot), 2), np.float32)
    if "noise" in shot.plan:
        away, drawn = _share_away(shot, scale), shot.numbers()
        for i, name in enumerate(("sensor.read_noise", "sensor.shot_noise")):
            out[:, i] = away * drawn[name].detach().numpy() ** 2
    return out
