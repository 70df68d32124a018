"""Where a shot's images lie: on the panel, on the sensor, and in the photo that they are, or are a
part of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from moireaug.scene.by_name import parts_with
from moireaug.scene.drawn_parts import DrawnDevelop, DrawnLens, DrawnPanel, DrawnSensor, DrawnView
from moireaug.scene.geometry.frame import Frame, FrameSize, frame_of_crop, size_of_crops_photo
from moireaug.scene.geometry.homography import focal_length, pose_of
from moireaug.scene.plan import Plan
from moireaug.scene.record import SceneRecord

Array = TypeVar("Array", Tensor, np.ndarray)


class ShotGeometry(Generic[Array]):
    """The geometry of B images, of drawn numbers that are tensors or, which is faster for so few,
    arrays, (B,) float64 each, of the module `xp`. The image begins at the row and column `corner`
    of one of the size `whole_size`."""

    scene: SceneRecord
    plan: Plan
    panel: DrawnPanel
    view: DrawnView
    lens: DrawnLens
    sensor: DrawnSensor
    develop: DrawnDevelop
    whole_size: tuple[int, int]
    corner: tuple[int, int]
    xp: ModuleType = torch
    _numbers: Mapping[str, Array]
    _kept: dict[str, Any] | None = None  # results of `_once`, if they are kept

    def _once(self, name: str, compute: Callable[[], Any]) -> Any:
        """Return what is computed, or where results are kept, was when it was first asked for."""
        if self._kept is None:
            return compute()
        if name not in self._kept:
            self._kept[name] = compute()
        return self._kept[name]

    def numbers(self) -> dict[str, Array]:
        """Return the drawn numbers, (B,) each, by name, such as "view.yaw"."""
        return dict(self._numbers)

    @property
    def panel_scale(self) -> Array:
        """Panel pixels per image pixel, (B,)."""
        n = self._numbers
        if self.scene.panel.width:
            return n["panel.width"] / max(self.whole_size)
        if self.scene.is_crop:
            return n["sensor.shrink"] * n["view.zoom"] / n["sensor.pitch"]
        return n["panel.scale"]

    @property
    def sensor_scale(self) -> Array:
        """Sensor pixels per photo pixel along each axis, (B,); `Sensor.pitch` holds in the middle
        of the picture before it is turned."""
        n = self._numbers
        if self.scene.is_crop:
            return n["sensor.shrink"]
        if not self.scene.sensor.pitch:
            return self.xp.full_like(n["panel.scale"], self.scene.sensor.scale)
        return n["sensor.pitch"] * self.panel_scale / self.magnification

    @property
    def bin_scale(self) -> Array:
        """Sensor pixels along each side of a binned reading's bins, (B,); of bins in the image's
        frame the root of their area in the middle of the picture."""
        scale, xp = self.sensor_scale, self.xp
        if not self.scene.is_rectified:
            return scale
        yaw, pitch = (xp.deg2rad(self._numbers[name]) for name in ("view.yaw", "view.pitch"))
        return scale * self.magnification * xp.sqrt(xp.cos(yaw) * xp.cos(pitch))

    @property
    def magnification(self) -> Array:
        """Photo pixels that an image pixel takes along each axis before it is turned, (B,)."""
        return self._numbers["view.zoom"] if self.scene.is_crop else self._pose[1]

    @property
    def homography(self) -> Array:
        """From image to ideal photo coordinates, both about their centres, (B, 3, 3)."""
        return self._pose[0]

    @property
    def _pose(self) -> tuple[Any, Any]:
        return self._once("pose", self._computed_pose)

    def _computed_pose(self) -> tuple[Any, Any]:
        lens, scale = (self._numbers["lens.k1"], self._numbers["lens.k2"]), self.scene.sensor.scale
        return pose_of(self.view, lens, self.photo_size, self.focal, scale, self.xp)

    @property
    def focal(self) -> Array:
        """Focal length in photo pixels, (B,): of crops the camera's, else from `View.fov`."""
        if self.scene.is_crop:
            return self.scene.sensor.focal * self.xp.maximum(*self.photo_size)
        return focal_length(self._numbers["view.fov"], self.whole_size, self.xp)

    @property
    def photo_size(self) -> FrameSize:
        """Height and width of the whole photo, numbers or (B,) each."""
        if self.scene.is_crop:
            shrink = self._numbers["sensor.shrink"]
            return size_of_crops_photo(self.scene.sensor.pixels, shrink, self.whole_size)
        return self.whole_size

    @property
    def lens_distortion(self) -> tuple[Any, Any]:
        """k1 and k2, (B,) each; zeros of a scene whose lens never distorts."""
        k1, k2 = self._numbers["lens.k1"], self._numbers["lens.k2"]
        if not self.scene.is_bent:
            return self.xp.zeros_like(k1), self.xp.zeros_like(k2)
        return k1, k2

    @property
    def frame(self) -> Frame:
        """The photo that the image is, or is a part of."""
        return self._once("frame", self._computed_frame)

    def _computed_frame(self) -> Frame:
        (height, width), (top, left) = self.whole_size, self.corner
        if not self.scene.is_crop:
            return Frame(height, width, top, left, top, left)
        place = self._numbers["sensor.crop_x"], self._numbers["sensor.crop_y"]
        size, lens = self.photo_size, self.lens_distortion
        whole = frame_of_crop(size, self.whole_size, place, self.homography, lens, self.xp)
        return whole.part(top, left)

    @property
    def panel_corner(self) -> Array:
        """Where on the panel the image's corner lies, x and y in panel pixels, (B, 2)."""
        alpha, (top, left) = self.panel_scale, self.corner
        if not self.scene.panel.width and self.scene.is_crop:
            frame = self.frame
            top, left = frame.image_top, frame.image_left
        return self.xp.stack((alpha * left, alpha * top), -1)


class HostGeometry(ShotGeometry[np.ndarray]):
    """A shot's geometry in arrays, of its `host_numbers`; pose and frame are computed once."""

    xp = np

    def __init__(self, shot: ShotGeometry, table: np.ndarray) -> None:
        self.scene, self.plan = shot.scene, shot.plan
        self.whole_size, self.corner = shot.whole_size, shot.corner
        self.table, self._numbers = table, dict(zip(shot.numbers(), table, strict=True))
        vars(self).update(parts_with(shot, self._numbers), _kept={})
