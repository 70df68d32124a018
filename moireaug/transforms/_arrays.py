"""Numpy images (H, W, C) and their masks, boxes and key points, through a shot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch

from moireaug.scenes import Shot
from moireaug.transforms._convert import at_size, move_boxes, photograph, shot_of_frames

# name of each target to the depth of its nesting
IMAGE_TARGETS = {"image": 0, "images": 1, "volume": 1}
MASK_TARGETS = {"mask": 0, "masks": 1, "mask3d": 1}


def check_arrays(target: str, value: Any, depth: int) -> None:
    """Refuse a value that is neither a numpy array nor, where `depth` is 1, a list of them:
    TypeError."""
    leaves = value if depth and isinstance(value, (list, tuple)) else [value]
    other_leaves = [leaf for leaf in leaves if not isinstance(leaf, np.ndarray)]
    if not other_leaves:
        return
    advice = "Convert it with np.asarray first."
    if isinstance(other_leaves[0], torch.Tensor):
        advice = (
            "Put this transform before ToTensorV2, or use moireaug.transforms.RandomMoire or "
            "AdversarialMoire, which take tensors."
        )
    allowed = "a numpy array or a list of them" if depth else "a numpy array"
    kind = type(other_leaves[0])
    got = f"{kind.__module__}.{kind.__name__}".removeprefix("builtins.")
    raise TypeError(f"{target} must be {allowed}; got {got}. {advice}")


def check_same(name: str, values: Iterable[Any]) -> None:
    """Refuse pictures of one call that differ in a property of this name: ValueError."""
    different = list(dict.fromkeys(values))
    if len(different) > 1:
        raise ValueError(
            f"the pictures of one call must have the same {name}; got "
            f"{', '.join(map(str, different))}. Call the transform once for each."
        )


def apply_to_one(image: np.ndarray, shot: Shot, noise: torch.Tensor | None = None) -> np.ndarray:
    """Return the photo of one image; see `apply_to_all`."""
    return apply_to_all([image], shot, noise)[0]


def apply_to_all(
    images: Sequence[np.ndarray] | np.ndarray, shot: Shot, noise: torch.Tensor | None = None
) -> np.ndarray:
    """Return the photos of N images, (H, W, 3), (H, W, 1) or (H, W), uint8 or float in [0, 1], by
    one shot of a single draw, stacked, in their shape and dtype; each has sensor noise of its own,
    see `shot_of_frames`, and its own attacker's noise."""
    if not len(images):
        return np.asarray(images)
    check_same("shape", (image.shape for image in images))
    check_same("dtype", (image.dtype for image in images))
    pictures = torch.cat([planes(image) for image in images])
    size = (pictures.shape[-2], pictures.shape[-1])
    if noise is not None and shot.size != size:
        raise ValueError(
            "a replayed AdversarialMoire holds noise for images of the size that it was recorded "
            f"at, {shot.size}; got {size}. Replay it at that size, or attack these images."
        )
    frames = shot_of_frames(at_size(shot, size), [len(images)] * len(shot))
    photos = photograph(pictures, frames, noise)
    stacked = photos.permute(0, 2, 3, 1).reshape(len(images), *images[0].shape).numpy()
    return stacked.astype(images[0].dtype, copy=False)


def planes(image: np.ndarray) -> torch.Tensor:
    """Return an image (H, W, C) or (H, W) as (1, C, H, W)."""
    if image.ndim not in (2, 3):
        raise ValueError(f"an image must have the shape (H, W, C) or (H, W); got {image.shape}.")
    if image.ndim == 3 and image.shape[2] not in (1, 3) and image.shape[0] in (1, 3):
        raise ValueError(
            "an image must have 3 channels (RGB) or 1 (grey), in the order (H, W, C); got "
            f"{image.shape}. Its channels seem to be first: put them last with transpose(1, 2, 0)."
        )
    # torch reads only the machine's byte order, and no long doubles
    dtype = image.dtype.newbyteorder("=")
    dtype = np.dtype(np.float64) if dtype == np.longdouble else dtype
    pixels = torch.from_numpy(np.array(image, dtype, order="C"))
    return pixels.reshape(1, *image.shape[:2], -1).permute(0, 3, 1, 2)


def move_mask(mask: np.ndarray, shot: Shot) -> np.ndarray:
    """Move a mask (H, W) or (H, W, C), of any dtype: nearest pixel, 0 off the image."""
    if mask.dtype == np.longdouble:
        return move_mask(mask.astype(np.float64), shot).astype(mask.dtype)
    # torch knows few of numpy's types, and moving pixels only needs their bits
    bits = mask.view(f"i{mask.itemsize}") if mask.dtype.kind in "iuf" else mask
    pixels = torch.from_numpy(np.array(bits, order="C"))
    channels = pixels.reshape(1, *mask.shape[:2], -1).permute(0, 3, 1, 2)
    moved = at_size(shot, mask.shape[:2]).to_photo_mask(channels)[0].permute(1, 2, 0)
    return moved.reshape(mask.shape).numpy().view(mask.dtype)


def move_bboxes(bboxes: np.ndarray, shot: Shot) -> np.ndarray:
    """Move rows of x1, y1, x2, y2, as fractions of the photo, and anything after. They may reach
    out of the photo, and have no area where they lie outside of it."""
    bboxes, (h, w) = _as_float(bboxes), shot.size
    sides = np.array([w, h, w, h], np.float64)
    moved = bboxes.copy()
    moved[:, :4] = move_boxes(torch.from_numpy(bboxes[:, :4] * sides), shot).numpy() / sides
    visible = moved[:, :4].clip(0, 1)
    # a Compose drops them, but refuses those that it clips to nothing itself
    outside = (visible[:, 0] >= visible[:, 2]) | (visible[:, 1] >= visible[:, 3])
    moved[outside, :4] = visible[outside]
    return moved


def move_keypoints(keypoints: np.ndarray, shot: Shot) -> np.ndarray:
    """Move rows of x, y, or x, y, z, angle, scale, and anything after: angle in radians, from x
    towards y."""
    keypoints = _as_float(keypoints)
    step = 1e-3  # pixels, for the rotation and magnification around each point
    points = torch.from_numpy(keypoints[:, :2].astype(np.float64)) + 0.5
    moved_points = shot.to_photo(points[None])[0]
    moved = keypoints.copy()
    moved[:, :2] = (moved_points - 0.5).numpy()
    if keypoints.shape[1] < 5:
        return moved
    angle = torch.from_numpy(keypoints[:, 3].astype(np.float64))
    along = torch.stack([angle.cos(), angle.sin()], -1) * step
    across = torch.stack([-angle.sin(), angle.cos()], -1) * step
    x_axis, y_axis = (
        (shot.to_photo((points + offset)[None])[0] - moved_points) / step
        for offset in (along, across)
    )
    moved[:, 3] = (torch.atan2(x_axis[:, 1], x_axis[:, 0]) % (2 * np.pi)).numpy()
    # rounding may reach 2 pi, which albumentations refuses
    moved[moved[:, 3] >= 2 * np.pi, 3] = 0.0
    moved[:, 4] *= torch.linalg.det(torch.stack([x_axis, y_axis], -1)).abs().sqrt().numpy()
    return moved


def _as_float(rows: np.ndarray) -> np.ndarray:
    """Return integer rows as float32, as a Compose does: moved ones lie between the integers."""
    rows = np.asarray(rows)
    return rows if rows.dtype.kind == "f" else rows.astype(np.float32)


def pictures_of(data: dict[str, Any]) -> dict[str, list[np.ndarray]]:
    """Return the images of each target of a call."""
    pictures = {}
    for target, depth in IMAGE_TARGETS.items():
        value = data.get(target)
        if value is not None:
            pictures[target] = list(value) if depth else [value]
    return pictures
