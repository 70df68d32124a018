"""A shot's drawn numbers for the kernels' records, in numpy."""

from __future__ import annotations

import numpy as np

from moireaug.engine.lower import pose
from moireaug.scene.fields import bounds
from moireaug.scene.geometry.frame import Frame, FrameSize, frame_of_crop, size_of_crops_photo
from moireaug.scene.geometry.homography import camera_pose
from moireaug.scene.shot import ShotRecord

MAX_CACHED_SCENES = 64  # scenes and sizes whose tables are cached


def numbers_of(shot: ShotRecord) -> dict[str, np.ndarray]:
    """Return the drawn numbers by name, "view.yaw", (B,) float64 each."""
    return dict(zip(shot.numbers(), shot.host_numbers(), strict=True))


def distortion_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return k1 and k2, (B,) each; zeros without a lens."""
    if "lens" not in shot.plan:
        return np.zeros(len(shot)), np.zeros(len(shot))
    return drawn["lens.k1"], drawn["lens.k2"]


def homography_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the homography from image to ideal photo coordinates, about the centres, (B, 3, 3)
    float64, and how many photo pixels an image pixel in the middle takes before it is turned,
    (B,)."""
    if shot.scene.view.pose != "camera":
        matrix = pose.centred(shot.matrix().detach().numpy(), shot.size)
        return matrix, np.ones(len(shot))
    view = shot.view.drawn({name: drawn[f"view.{name}"] for name in shot.view.ranged})
    return camera_pose(view, drawn["lens.k1"], drawn["lens.k2"], _photo_size_of(shot, drawn), np)


def _photo_size_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> FrameSize:
    if shot.scene.is_crop:
        sensor = shot.scene.sensor
        return size_of_crops_photo(sensor.pixels, drawn["sensor.shrink"], shot.whole_size)
    return shot.whole_size


def frame_of(shot: ShotRecord, drawn: dict[str, np.ndarray], homography: np.ndarray) -> Frame:
    """Return `shot.frame`, given the first result of `homography_of`."""
    (height, width), (top, left) = shot.whole_size, shot.corner
    if not shot.scene.is_crop:
        return Frame(height, width, top, left, top, left)
    size, place = _photo_size_of(shot, drawn), (drawn["sensor.crop_x"], drawn["sensor.crop_y"])
    lens = distortion_of(shot, drawn)
    return frame_of_crop(size, shot.whole_size, place, homography, lens, np).part(top, left)


def panel_scale_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> np.ndarray:
    """Return `shot.panel_scale`."""
    if bounds(shot.scene.panel.width)[1]:
        return drawn["panel.width"] / max(shot.whole_size)
    if shot.scene.is_crop:
        return drawn["sensor.shrink"] * drawn["view.zoom"] / drawn["sensor.pitch"]
    return drawn["panel.scale"]


def sensor_scale_of(
    shot: ShotRecord, drawn: dict[str, np.ndarray], magnified: np.ndarray
) -> np.ndarray:
    """Return `shot.sensor_scale`, given the second result of `homography_of`."""
    if shot.scene.is_crop:
        return drawn["sensor.shrink"]
    if not bounds(shot.scene.sensor.pitch)[1]:
        return np.full(len(shot), shot.scene.sensor.scale)
    return drawn["sensor.pitch"] * panel_scale_of(shot, drawn) / magnified


def bin_scale_of(
    shot: ShotRecord, drawn: dict[str, np.ndarray], magnified: np.ndarray
) -> np.ndarray:
    """Return `shot.bin_scale`, given the second result of `homography_of`."""
    scale = sensor_scale_of(shot, drawn, magnified)
    if not shot.scene.is_rectified:
        return scale
    yaw, pitch = np.deg2rad(drawn["view.yaw"]), np.deg2rad(drawn["view.pitch"])
    return scale * magnified * np.sqrt(np.cos(yaw) * np.cos(pitch))
