"""The torchvision v2 transform: RandomMoire for tensors, tv_tensors and PIL images, alone or in a
`v2.Compose`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import PIL.Image
import torch
from torch import Tensor
from torchvision import tv_tensors
from torchvision.transforms import v2
from torchvision.transforms.v2 import functional as F
from torchvision.tv_tensors import BoundingBoxes, BoundingBoxFormat, KeyPoints, Mask, Video

from moireaug.common.numeric import as_dtype
from moireaug.mixtures import SceneLike, draw_one
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Shot
from moireaug.transforms._convert import (
    check_format,
    check_probability,
    describe,
    move_boxes,
    photograph,
    planned_scenes,
    shot_of_frames,
    warn_without_moire,
    with_rows,
)

IMAGE_TYPES = (PIL.Image.Image, tv_tensors.Image, Video, v2._utils.is_pure_tensor)
ANNOTATION_TYPES = (BoundingBoxes, Mask, KeyPoints)
UPRIGHT_BOX_FORMATS = (BoundingBoxFormat.XYXY, BoundingBoxFormat.XYWH, BoundingBoxFormat.CXCYWH)
PIL_MODES = ("RGB", "L", "RGBA", "LA")


class RandomMoire(v2.Transform):
    """Photograph images on a screen, each with probability `p`.

        v2.Compose([v2.RandomHorizontalFlip(), RandomMoire(scene="screen_photo", p=0.5),
        v2.Normalize(mean, std)])

    Args:
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each image is then
            photographed in one of them. "anywhere" is the mixture of every screen. One shot is
            drawn per image, from torch's global generator: DataLoader workers differ, and
            `torch.manual_seed` makes draws reproducible.
        p: probability of a photo, in [0, 1].
        shrink: images are crops, parts of larger photos with so many sensor pixels per image pixel,
            a number or a (low, high) pair: 1 is the camera's own resolution, 3 that of a photo of
            3000 pixels sent as 1000. None: images are what the scene says, in presets whole photos,
            in which little moiré is left below 200 pixels. See `Scene.with_shrink`.

    Images are pure tensors and `tv_tensors.Image` ([B,] C, H, W), `tv_tensors.Video` ([B,] T, C, H,
    W) and PIL images of mode RGB, L, RGBA or LA; C is 3, or 1 for grey, which is shown as grey RGB
    and returned as luma; uint8 or floating point in [0, 1], so use it before `v2.Normalize`. Values
    that resizing, blur or noise left a little outside are clipped, see
    `moireaug.common.image_checks`. Type, shape, dtype, device and memory layout are kept; float64
    is computed in float32. Inputs are never modified.

    A batch (B, C, H, W) has one draw per image, and only the chosen images are computed. A video is
    one scene: its frames share the shot and differ only in sensor noise. Images of one sample share
    the draw. Images that are not chosen are returned unchanged. Differentiable in floating-point
    images.

    Labels, masks, boxes and key points are returned as the same objects, unless the scene, or one
    of a list, leaves the photo in the camera's frame (`Develop(registered=False)` with a pose or a
    lens): then masks, boxes, key points and a PIL image's alpha move with the picture. Boxes become
    those that enclose the moved ones, clamped to the canvas unless their `clamping_mode` is None;
    key points may leave the photo; both are in continuous coordinates, with pixel centres at half
    integers. Integer ones are rounded.

    Raises:
        TypeError, ValueError: an unknown scene, a p out of range, another number of channels, dtype
            or PIL mode, numpy arrays, float images that cannot be pictures in [0, 1], images of
            different batch sizes in one sample; in the camera's frame also rotated boxes, and boxes
            or key points that cannot be told apart by image.
    """

    def __init__(
        self,
        scene: SceneLike = "screen_photo",
        p: float = 0.5,
        shrink: float | tuple[float, float] | None = None,
    ) -> None:
        super().__init__()
        self.scene = planned_scenes(scene, shrink)
        self.p = check_probability(p)
        annotations = ANNOTATION_TYPES if self.scene.moves else ()
        self._transformed_types = IMAGE_TYPES + annotations

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        needs_transform = self._needs_transform_list(flat_inputs)
        leaves = [x for x, needed in zip(flat_inputs, needs_transform, strict=True) if needed]
        images = [x for x in leaves if not isinstance(x, ANNOTATION_TYPES)]
        _refuse_arrays(flat_inputs, images)
        for image in images:
            _check_image(image)
        counts = sorted({_count(image) for image in images})
        if len(counts) > 1:
            raise ValueError(
                "images of one sample must have one batch size; got "
                f"{' and '.join(map(str, counts))}."
            )
        for leaf in (x for x in leaves if isinstance(x, ANNOTATION_TYPES)):
            _check_annotation(leaf, *counts)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        n = next((_count(x) for x in flat_inputs if not isinstance(x, ANNOTATION_TYPES)), 1)
        chosen = (torch.rand(n, dtype=torch.float32, device="cpu") < self.p).nonzero().flatten()
        return {"chosen": chosen, "u": self.scene.random_numbers(n)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        chosen, u = params["chosen"], params["u"]
        if not len(chosen):
            return inpt
        height, width = F.get_size(inpt)
        warn_without_moire(self.scene, (height, width))
        shot: Shot | MixedShot
        if len(chosen) == 1:  # of one scene: a mixture's takes three times as long
            shot = draw_one(self.scene, u[chosen], (height, width))
        else:
            shot = self.scene.draw(u[chosen], (height, width))
        if len(chosen) == len(u):
            return apply_shot(inpt, shot)
        plain, rows = inpt.as_subclass(Tensor), chosen.to(inpt.device)
        return wrap(with_rows(plain, rows, _apply_to_tensor(plain[rows], inpt, shot)), inpt)

    def extra_repr(self) -> str:
        return f"p={self.p}, scene={describe(self.scene)}"


def apply_shot(inpt: Any, shot: Shot | MixedShot) -> Any:
    """Return one leaf of a sample, an image or its masks, boxes or key points, as in the shot's
    photo.

    Arguments and errors as in `RandomMoire`; `shot` holds one draw per image, of its size, and one
    per video.
    """
    if isinstance(inpt, PIL.Image.Image):
        return _apply_to_pil(inpt, shot)
    return wrap(_apply_to_tensor(inpt.as_subclass(Tensor), inpt, shot), inpt)


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
    return F.convert_bounding_box_format(moved, BoundingBoxFormat.XYXY, boxes.format).to(
        plain.dtype
    )


def wrap(plain: Tensor, like: Tensor) -> Tensor:
    """Return a tensor as the type of `like`, with its format and canvas size if it has these."""
    return tv_tensors.wrap(plain, like=like) if isinstance(like, tv_tensors.TVTensor) else plain


def _refuse_arrays(leaves: list[Any], images: list[Any]) -> None:
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


def _count(image: Any) -> int:
    """Return the number of draws of an image leaf: one, or one for each row of a batch."""
    if isinstance(image, PIL.Image.Image):
        return 1
    return image.shape[0] if image.ndim - isinstance(image, Video) == 4 else 1


def _check_image(image: Any) -> None:
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


def _check_annotation(leaf: Tensor, n: int = 1) -> None:
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
