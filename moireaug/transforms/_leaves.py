"""The leaves of a torchvision sample: which are images, which go with them, what each becomes in a
photo, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import PIL.Image
import torch
from torch import Tensor
from torchvision import tv_tensors
from torchvision.transforms.v2 import functional as F
from torchvision.tv_tensors import BoundingBoxes, BoundingBoxFormat, KeyPoints, Mask, Video

from moireaug.common.numeric import as_dtype
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Shot
from moireaug.transforms._convert import check_format, move_boxes, photograph, shot_of_frames


def is_pure_tensor(value: object) -> bool:
    """Return whether a value is a tensor that torchvision has given no other meaning."""
    return isinstance(value, Tensor) and not isinstance(value, tv_tensors.TVTensor)


IMAGE_TYPES = (PIL.Image.Image, tv_tensors.Image, Video, is_pure_tensor)
ANNOTATION_TYPES = (BoundingBoxes, Mask, KeyPoints)
UPRIGHT_BOX_FORMATS = (BoundingBoxFormat.XYXY, BoundingBoxFormat.XYWH, BoundingBoxFormat.CXCYWH)
PIL_MODES = ("RGB", "L", "RGBA", "LA")


def apply_shot(inpt: Any, shot: Shot | MixedShot, rows: Tensor | None = None) -> Any:
    """Return one leaf of a sample, an image or its masks, boxes or key points, as in the photo by a
    shot of one draw per image or video, of its size; of a batch, perhaps of some rows alone."""
    if isinstance(inpt, PIL.Image.Image):
        return _apply_to_pil(inpt, shot)
    plain = inpt.as_subclass(Tensor)
    if rows is None:
        return wrap(_apply_to_tensor(plain, inpt, shot), inpt)
    rows = rows.to(plain.device)
    photos = _apply_to_tensor(plain[rows], inpt, shot)
    return wrap(plain.clone().index_copy_(0, rows, photos), inpt)


def _apply_to_tensor(plain: Tensor, leaf: Tensor, shot: Shot | MixedShot) -> Tensor:
    """Return plain values of a leaf's kind as in the shot's photo; see `apply_shot`."""
    if isinstance(leaf, BoundingBoxes):
        return _apply_to_boxes(plain, leaf, shot)
    if isinstance(leaf, KeyPoints):
        moved = shot.to_photo(plain.double().reshape(len(shot), -1, 2))
        return as_dtype(moved, plain.dtype).reshape(plain.shape)
    if isinstance(leaf, Mask):
        flat = plain.reshape(len(shot), -1, *plain.shape[-2:])
        return shot.to_photo_mask(flat).reshape(plain.shape)
    if isinstance(leaf, Video):
        shot = shot_of_frames(shot, [plain.shape[-4]] * len(shot))
    batch = plain.reshape(math.prod(plain.shape[:-3]), *plain.shape[-3:])
    return photograph(batch, shot).reshape(plain.shape)


def _apply_to_pil(image: PIL.Image.Image, shot: Shot | MixedShot) -> PIL.Image.Image:
    with torch.device("cpu"):
        planes = F.pil_to_tensor(image)[None]
    colours = 3 if image.mode.startswith("RGB") else 1
    photo = photograph(planes[:, :colours], shot)
    alpha = shot.to_photo_mask(planes[:, colours:])
    return F.to_pil_image(torch.cat([photo, alpha], 1)[0], mode=image.mode)


def _apply_to_boxes(plain: Tensor, boxes: BoundingBoxes, shot: Shot | MixedShot) -> Tensor:
    corners = F.convert_bounding_box_format(plain.double(), boxes.format, BoundingBoxFormat.XYXY)
    moved = move_boxes(corners, shot)
    if getattr(boxes, "clamping_mode", "soft") is not None:
        h, w = boxes.canvas_size
        moved = torch.minimum(moved.clamp(min=0), moved.new_tensor([w, h, w, h]))
    if not plain.is_floating_point():
        moved = moved.round()  # the corners: a rounded width could miss the rounded corner
    moved = F.convert_bounding_box_format(moved, BoundingBoxFormat.XYXY, boxes.format)
    return moved.to(plain.dtype)


def wrap(plain: Tensor, like: Tensor) -> Tensor:
    """Return a tensor as the type of `like`, with its format and canvas size if it has these."""
    return tv_tensors.wrap(plain, like=like) if isinstance(like, tv_tensors.TVTensor) else plain


def refuse_arrays(leaves: list[Any], images: list[Any]) -> None:
    """Refuse a numpy image, which v2 would return untouched; arrays beside an image are ignored."""
    if any(isinstance(x, PIL.Image.Image) or x.ndim >= 3 for x in images):
        return
    for x in leaves:
        if isinstance(x, np.ndarray) and x.ndim >= 2:
            raise TypeError(
                "torchvision's RandomMoire takes tensors and PIL images; got a numpy array of "
                f"shape {x.shape}. Use moireaug.transforms.albumentations.RandomMoire, or "
                "v2.ToImage() before this transform."
            )


def draw_count(image: Any) -> int:
    """Return the number of draws of an image leaf: one, or one for each row of a batch."""
    if isinstance(image, PIL.Image.Image):
        return 1
    return image.shape[0] if image.ndim - isinstance(image, Video) == 4 else 1


def check_image(image: Any) -> None:
    """Refuse an image leaf of another PIL mode, shape or dtype than `RandomMoire` takes."""
    if isinstance(image, PIL.Image.Image):
        if image.mode not in PIL_MODES:
            advice = "Convert with v2.RGB()"
            if image.mode.startswith(("I", "F")):  # PIL would cut off their values at 255
                advice = "Scale it to float in [0, 1] as a tensor"
            raise ValueError(
                f"PIL images must be of mode {', '.join(PIL_MODES)}; got {image.mode}. {advice} "
                "before this transform, or wrap a segmentation map as tv_tensors.Mask."
            )
        return
    video = isinstance(image, Video)
    shape = "(T, C, H, W) or (B, T, C, H, W)" if video else "(C, H, W) or (B, C, H, W)"
    if image.ndim - video not in (3, 4):
        hint = ""
        if image.ndim == 2:
            hint = " Give a grey image its channel: image[None]."
        elif image.ndim > 4 and not video:
            hint = " Wrap frames of one scene as tv_tensors.Video."
        raise ValueError(
            f"{'videos' if video else 'images'} must have the shape {shape}; got "
            f"{tuple(image.shape)}.{hint}"
        )
    check_format(image)


def check_annotation(leaf: Tensor, n: int = 1) -> None:
    """Refuse annotations that cannot be moved: rotated boxes, and leaves of a batch without a row
    for each image."""
    if isinstance(leaf, BoundingBoxes) and leaf.format not in UPRIGHT_BOX_FORMATS:
        raise ValueError(
            f"rotated boxes ({leaf.format.value}) do not stay boxes in a photo with perspective or "
            "a lens. Give them as XYXY, XYWH or CXCYWH, or use a scene with "
            "Develop(registered=True), which moves nothing."
        )
    # boxes are (N, 4): they have no room for a batch
    smallest = 4 if isinstance(leaf, BoundingBoxes) else 3
    if n != 1 and (leaf.ndim < smallest or leaf.shape[0] != n):
        raise ValueError(
            f"a {type(leaf).__name__} of shape {tuple(leaf.shape)} does not say which of {n} "
            "images each row belongs to. Apply the transform before batching, or use a scene with "
            "Develop(registered=True): it moves nothing."
        )
