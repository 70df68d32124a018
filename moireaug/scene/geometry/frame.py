"""The photo that an image is, or is a part of."""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.common.physics.lens import MIN_RAY_DEPTH, radial_factor
from moireaug.scene.sensor import SHORTER_SIDE

Number = float | Tensor  # a number, or one per image, (B,) float64
Pair = tuple[Any, Any]  # of numbers, tensors or arrays
FrameSize = Pair  # height and width, a `Number` each


class Frame(NamedTuple):
    """The photo that an image is, or is a part of, in photo pixels: numbers where the image is the
    whole photo or a given part of it, else (B,) float64 each.

    height, width: of the photo, and of the picture's frame.
    image_top, image_left: where the image lies in the picture's frame.
    photo_top, photo_left: where its photo lies in the whole one.
    """

    height: Any
    width: Any
    image_top: Any
    image_left: Any
    photo_top: Any
    photo_left: Any

    @property
    def size(self) -> FrameSize:
        return self.height, self.width

    def part(self, top: int, left: int) -> Frame:
        """Return the Frame of a part, whose corner lies at a row and a column of the image."""
        image = self.image_top + top, self.image_left + left
        return Frame(*self.size, *image, self.photo_top + top, self.photo_left + left)

    def image_corner(self, like: Tensor) -> Tensor:
        """Return x and y of the image's corner, for points of like's shape (..., 2)."""
        return planar(self.image_left, self.image_top, like)

    def photo_corner(self, like: Tensor) -> Tensor:
        """Return u and v of its photo's corner, as `image_corner` does."""
        return planar(self.photo_left, self.photo_top, like)


def planar(x: Number, y: Number, like: Tensor) -> Tensor:
    """Return a vector that broadcasts over points like (B, ..., 2): (2,), or (B, 1, ..., 2)."""
    if not isinstance(x, Tensor):
        return like.new_tensor([x, y])
    other = torch.as_tensor(y, dtype=x.dtype, device=x.device)
    pair = torch.stack((x, other.expand_as(x)), -1).to(like.dtype)
    return pair.reshape(len(pair), *[1] * (like.ndim - 2), 2)


def per_pixel(number: Number, dtype: torch.dtype | None = None) -> Any:
    """Return a number that broadcasts over (B, h, w)."""
    return number[:, None, None].to(dtype) if isinstance(number, Tensor) else number


def size_of_crops_photo(pixels: float, shrink: Any, size: tuple[int, int]) -> FrameSize:
    """Return height and width of the photo that a crop of `size` is a part of, (B,) each: of the
    sensor, of so many `pixels` along its longer side, shrunk by `shrink` (B,), of torch or numpy,
    or the crop's own if that is larger."""
    longer = pixels / shrink
    return (longer * SHORTER_SIDE).clip(min=size[0]), longer.clip(min=size[1])


def frame_of_crop(
    frame: FrameSize, size: tuple[int, int], place: Pair, pose: Any, lens: Pair, xp: ModuleType
) -> Frame:
    """Return the Frame of a crop that lies at a place in its photo, and whose image is in the
    middle of it.

    frame: from `size_of_crops_photo`. size: of the crop.
    place: across and down, from 0 at the edges of the photo to 1 at the opposite ones, (B,).
    pose, xp: see `homography.camera_pose`. lens: k1 and k2, (B,).
    """
    (height, width), (h, w), (k1, k2) = frame, size, lens
    spare_h, spare_w = height - h, width - w
    u, v = (place[0] - 0.5) * spare_w, (place[1] - 0.5) * spare_h
    r2 = (u * u + v * v) * (4 / (height * height + width * width))
    factor = radial_factor(r2, k1, k2)
    back = xp.linalg.inv(pose)
    x, y, depth = (
        back[:, i, 0] * (u * factor) + back[:, i, 1] * (v * factor) + back[:, i, 2]
        for i in range(3)
    )
    depth = depth.clip(min=MIN_RAY_DEPTH)
    image = y / depth + spare_h / 2, x / depth + spare_w / 2
    return Frame(height, width, *image, v + spare_h / 2, u + spare_w / 2)
