"""From a Shot to how the bins of a binned reading see the panel, and to its Beats."""

from __future__ import annotations

import numpy as np
import torch

from moireaug.camera.effects.sensor import lost_noise_variances, pixels_per_value
from moireaug.camera.exposure.bin_content import BinContent, content_of
from moireaug.camera.exposure.bin_geometry import (
    clamped_photo_points,
    enlargement,
    triangle_factor,
)
from moireaug.camera.exposure.extremes import FLOAT64_ON_CPU
from moireaug.camera.panel import amplitudes_of, mean_light_of
from moireaug.engine.lower.exposure_records import Beats, BinnedView, Cell, FullView
from moireaug.engine.lower.full import (
    camera_fields,
    cell_of_whole_pixels,
    from_corner,
    lower_cameras,
)
from moireaug.scene.geometry import grids
from moireaug.scene.geometry.frame import Frame
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry

BORDER_POINTS = 9  # along each axis, where the rows are taken that a part of a photo sees


def binned_view(shot: ShotRecord, geometry: HostGeometry) -> tuple[np.ndarray, Cell, BinnedView]:
    """Return a shot's cameras, of photo pixels, (B, fields), its Cell and its BinnedView."""
    content = content_of(geometry)
    fields = camera_fields(geometry) | _place_of(shot, geometry.frame, content)
    cameras, blur_cameras, sensors = _bin_cameras(geometry, fields, content)
    # none at the same height: centres differ
    cell = cell_of_whole_pixels(shot.plan.method.taps)
    cell = cell._replace(y_group=np.arange(3), kind_y_group=np.arange(3))
    beats = _beats_of(geometry, sensors, content)
    return cameras, cell, BinnedView(_picture_view(blur_cameras, content), beats)


def _place_of(shot: ShotRecord, frame: Frame, content: BinContent) -> dict[str, np.ndarray]:
    """Return the fields of cameras that say where on the whole photo the bins lie, and where the
    panel that shows the picture begins."""
    zero, (h, w) = np.zeros(len(shot)), shot.size
    top, left = frame.photo_top, frame.photo_left
    if shot.scene.is_rectified:
        top, left = frame.image_top, frame.image_left
    lead = content.lead / content.scale[:, None]  # in image pixels
    fields = {
        "centre_u": zero + (left + (w - frame.width) / 2),
        "centre_v": zero + (top + (h - frame.height) / 2),
        "lead_x": content.lead[:, 0],
        "lead_y": content.lead[:, 1],
        "corner_x": frame.width / 2 - frame.image_left + lead[:, 0],
        "corner_y": frame.height / 2 - frame.image_top + lead[:, 1],
    }
    if "flicker" in shot.plan and (shot.part_of is not None or shot.scene.is_crop):
        first, last = _rows_seen(shot, frame)
        fields |= {"pulses_top": first - frame.height / 2, "pulses_height": last - first}
    return fields


def _rows_seen(shot: ShotRecord, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last row of the whole photo that a shot's bins see, (B,) each, with
    a row to spare."""
    if not shot.scene.is_rectified:
        top = np.zeros(len(shot)) + frame.photo_top
        return top, top + shot.size[0]
    axes = [torch.linspace(0, side, BORDER_POINTS, **FLOAT64_ON_CPU) for side in shot.size]
    points = grids.grid(*axes).expand(len(shot), -1, -1, -1)
    with torch.no_grad():
        v = clamped_photo_points(points, shot)[0][..., 1].flatten(1)
    return v.amin(1).numpy() - 1, v.amax(1).numpy() + 1


def _bin_cameras(
    geometry: HostGeometry,
    fields: dict[str, np.ndarray],
    content: BinContent,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a shot's cameras, (B, fields) each: of photo pixels, of what blurs them and of sensor
    pixels; fields: those of sensor pixels."""
    bin_scale, is_rectified = geometry.bin_scale, geometry.scene.is_rectified
    zero, enlarged = np.zeros_like(bin_scale), enlargement(bin_scale, geometry.scene)
    inverse = np.linalg.inv(geometry.homography)
    of_bins = fields | {"alpha": content.scale, "fill": enlarged}
    if "noise" in geometry.plan:
        root = np.sqrt(pixels_per_value(geometry, bin_scale))
        of_bins |= {name: fields[name] / root for name in ("dark_noise", "photon_noise")}
    sensor = fields | {"alpha": geometry.panel_scale, "rectified": zero + is_rectified}
    blur = {"alpha": content.scale, "fill": zero, "blur": content.optics.blur}
    corner = fields["corner_x"][:, None], fields["corner_y"][:, None]
    images = of_sensor = from_corner(inverse, *corner)
    if is_rectified:
        # pixels look straight at the picture
        of_bins |= {"k1": zero, "k2": zero}
        images = from_corner(np.eye(3)[None].repeat(len(zero), 0), *corner)
        of_sensor = inverse
    per_pixel = (geometry.sensor_scale,) * 2
    return (
        lower_cameras(images, (1.0, 1.0), of_bins),
        lower_cameras(of_sensor, per_pixel, sensor | blur),
        lower_cameras(of_sensor, per_pixel, sensor),
    )


def _picture_view(blur_cameras: np.ndarray, content: BinContent) -> FullView:
    light = np.ones((len(content.width), 3, 1, 1))
    added_variance = np.repeat(content.interpolation_variance, 6).reshape(-1, 3, 2)
    return FullView(blur_cameras, light, np.ascontiguousarray(content.width), added_variance)


def _beats_of(geometry: HostGeometry, sensors: np.ndarray, content: BinContent) -> Beats:
    """Return a shot's Beats; sensors: the cameras of sensor pixels."""
    scene, plan, bin_scale = geometry.scene, geometry.plan, geometry.bin_scale
    harmonics = plan.method.harmonics
    waves = np.stack(amplitudes_of(geometry, harmonics), -1)
    waves = np.ascontiguousarray(waves.transpose(2, 0, 1, 3))  # (B, 3, K, 2)
    enlarged = enlargement(bin_scale, scene)
    return Beats(
        cameras=sensors,
        enlargement=enlarged,
        sampled=scene.develop.resize == "point",
        triangle=triangle_factor(enlarged, scene),
        ratio=content.ratio,
        centres=0.5 + content.shift,
        start=np.ascontiguousarray(content.start),
        period=np.array(scene.panel.cell.period, np.int64),
        orders=np.array(harmonics, np.int64).reshape(-1, 2),
        coefficients=waves.astype(np.float32),
        strength=np.ascontiguousarray(np.sqrt((waves**2).sum(-1)).max(1)),
        mean=mean_light_of(geometry),
        lost_noise_variance=np.stack(lost_noise_variances(geometry), 1).astype(np.float32),
        saturates="saturate" in plan,
        bayer=scene.is_binned_bayer,
    )
