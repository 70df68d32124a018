"""From a Shot to the records of its binned reading; cached as in `exposure`."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import torch

from moireaug.effects.sensor import averaged_pixels
from moireaug.engine.lower import lowering, pose
from moireaug.engine.lower.exposure_records import Beats, Cell
from moireaug.engine.lower.numbers import bin_scale_of, panel_scale_of, sensor_scale_of
from moireaug.exposure.bin_content import Content
from moireaug.panel.fourier import amplitudes_of, emitting_share, mean_light
from moireaug.scene.layout import as_layout
from moireaug.shot import ShotRecord


class BinScales(NamedTuple):
    """`shot.panel_scale`, `shot.sensor_scale` and `shot.bin_scale`, (B,) each."""

    panel: np.ndarray
    sensor: np.ndarray
    bin: np.ndarray

    @property
    def enlargement(self) -> np.ndarray:
        """Factor by which bins are enlarged to the size of a sensor pixel, (B,)."""
        return np.maximum(1 / self.bin, 1)


def bin_scales(shot: ShotRecord, drawn: dict[str, np.ndarray], magnified: np.ndarray) -> BinScales:
    """Return a shot's BinScales, given its numbers and the second result of `homography_of`."""
    sensor = sensor_scale_of(shot, drawn, magnified)
    bin_ = bin_scale_of(shot, drawn, magnified)
    return BinScales(panel_scale_of(shot, drawn), sensor, bin_)


class BinCameras(NamedTuple):
    """The cameras of a binned reading, (B, fields) each: of photo pixels, of what blurs them and of
    sensor pixels; see `exposure_records`."""

    pixels: np.ndarray
    lenses: np.ndarray
    sensors: np.ndarray


def lower_bin_cameras(
    shot: ShotRecord,
    inverse: np.ndarray,
    fields: dict[str, np.ndarray],
    seen: Content,
    scales: BinScales,
) -> BinCameras:
    """Return a shot's BinCameras.

    Args:
        inverse: (B, 3, 3), from ideal photo to image coordinates, both about the centre.
        fields: see `lowering.lower_cameras`, of sensor pixels.
    """
    zero = np.zeros(len(shot))
    of_bins = fields | _noise_of_bins(shot, scales.bin)
    of_bins |= {"alpha": seen.scale.numpy(), "fill": scales.enlargement}
    sensor = fields | {"alpha": scales.panel, "rectified": zero + shot.scene.is_rectified}
    blur = {"alpha": seen.scale.numpy(), "fill": zero, "blur": seen.optics.blur.numpy()}
    images = pose.from_corner(inverse, shot.size)
    of_sensor = images
    if shot.scene.is_rectified:
        # pixels look straight at the picture
        of_bins |= {"k1": zero, "k2": zero}
        images = pose.from_corner(np.eye(3)[None].repeat(len(shot), 0), shot.size)
        of_sensor = inverse
    per_pixel = scales.sensor, scales.sensor
    return BinCameras(
        lowering.lower_cameras(images, shot.size, (1.0, 1.0), of_bins),
        lowering.lower_cameras(of_sensor, shot.size, per_pixel, sensor | blur),
        lowering.lower_cameras(of_sensor, shot.size, per_pixel, sensor),
    )


def _noise_of_bins(shot: ShotRecord, scale: np.ndarray) -> dict[str, np.ndarray]:
    """Return the noise of bins of `scale` (B,) sensor pixels a side."""
    if "noise" not in shot.plan:
        return {}
    root, drawn = averaged_pixels(shot, torch.from_numpy(scale)).sqrt(), shot.numbers()
    read, photons = (drawn[f"sensor.{name}_noise"] / root for name in ("read", "shot"))
    return {"read": read.detach().numpy(), "shot": photons.detach().numpy()}


def shapes_in_bins(seen: Content) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coefficients, widths and added variances of `exposure_records.Exposure`: of pixels
    that emit all over."""
    width, hold = seen.width.detach().numpy(), seen.hold.detach().numpy()
    added_variance = np.repeat(hold, 6).reshape(-1, 3, 2)
    return np.ones((len(hold), 3, 1, 1)), np.ascontiguousarray(width), added_variance


@functools.lru_cache(maxsize=8)
def cell_in_bins(taps: int) -> Cell:
    """Return the Cell of a panel that shows one pixel of each colour, of which `taps` are looked at
    along each axis; its centres differ by image."""
    none = np.empty((2, 0), np.int64)
    subpixels = [(channel, (0.5, 0.5), channel) for channel in range(3)]
    cell = lowering.lower_cell(subpixels, [(1, 1)] * 3, [none] * 3, taps // 2)
    # none at the same height: centres differ
    return cell._replace(y_group=np.arange(3), kind_y_group=np.arange(3))


def lower_beats(shot: ShotRecord, sensors: np.ndarray, seen: Content, scales: BinScales) -> Beats:
    """Return a shot's Beats; sensors: see `BinCameras`."""
    layout, method = as_layout(shot.scene.panel.layout), shot.plan.method
    harmonics = np.array(method.harmonics, np.int64).reshape(-1, 2)
    lit = [share.detach() for share in emitting_share(shot.panel)]
    parts = amplitudes_of(layout, method.harmonics, shot.panel)
    waves = np.stack([part.detach().numpy() for part in parts], -1)
    waves = np.ascontiguousarray(waves.transpose(2, 0, 1, 3))  # (B, 3, K, 2)
    mean = np.stack([mean_light(layout, c, *(t.numpy() for t in lit)) for c in range(3)], 1)
    centres = 0.5 + seen.shift.detach().numpy()
    return Beats(
        cameras=sensors,
        enlargement=scales.enlargement,
        triangle=1 / scales.enlargement
        if shot.scene.develop.resize == "antialias"
        else 0 * scales.enlargement,
        ratio=np.ascontiguousarray(seen.ratio.detach().numpy()),
        centres=np.ascontiguousarray(centres),
        period=np.array(layout.period, np.int64),
        orders=harmonics,
        coefficients=waves.astype(np.float32),
        strength=np.ascontiguousarray(np.sqrt((waves**2).sum(-1)).max(1)),
        mean=mean,
        lost_noise_variance=_lost_noise_variance(shot, scales.bin),
        saturates="saturate" in shot.plan,
        bayer=shot.scene.cells == "binned",
    )


def _lost_variance_share(shot: ShotRecord, scale: np.ndarray) -> np.ndarray:
    """Return the share of the variance of sensor pixels that bins average away, (B,)."""
    return (1 - 1 / averaged_pixels(shot, torch.from_numpy(scale))).numpy()


def _lost_noise_variance(shot: ShotRecord, scale: np.ndarray) -> np.ndarray:
    """Return the variance of the noise that bins average away, (B, 2) float32: in the dark, and
    what a reading of 1 adds; zeros without noise."""
    out = np.zeros((len(shot), 2), np.float32)
    if "noise" in shot.plan:
        share, drawn = _lost_variance_share(shot, scale), shot.numbers()
        for i, name in enumerate(("sensor.read_noise", "sensor.shot_noise")):
            out[:, i] = share * drawn[name].detach().numpy() ** 2
    return out
