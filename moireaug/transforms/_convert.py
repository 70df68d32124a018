"""Conversions for all transforms: images of any type to the capture's floats and back, and boxes in
the camera's frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

import torch
from torch import Tensor, nn

from moireaug.capture import photo_of
from moireaug.common.image_checks import channels_last_hint, check_images, check_shape
from moireaug.common.networks import first_weight, in_evaluation_mode, rejects_of
from moireaug.common.numeric import as_float, luma
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scene.track import DEFAULT_HAND, TRIPOD, track_of
from moireaug.scenes import Shot

AnyShot = TypeVar("AnyShot", bound=Shot | MixedShot)
EDGE_POINTS = 17  # along each edge of a box: the arc of a bent edge is found to a 256th of its rise


def at_size(shot: AnyShot, size: tuple[int, int]) -> AnyShot:
    """Return the same shot of images of another size (height, width): every drawn number is
    relative to the picture."""
    h, w = size
    return shot if shot.size == (h, w) else dataclasses.replace(shot, size=(h, w))


def shot_of_frames(shot: AnyShot, counts: Sequence[int]) -> AnyShot:
    """Return row i of a shot as counts[i] frames, see `track_of`, filmed by hand; in the camera's
    frame, where boxes and masks move once for all frames, by a camera that stands still."""
    if list(counts) == [1] * len(shot):
        return shot
    return track_of(shot, counts, TRIPOD if shot.moves else DEFAULT_HAND)


def check_format(images: Tensor) -> None:
    """Refuse images (..., C, H, W) of a dtype or a number of channels that no transform takes; see
    `photograph`."""
    if images.dtype != torch.uint8 and not images.is_floating_point():
        raise TypeError(
            f"images must be uint8 or floating point in [0, 1]; got {images.dtype}. Convert them "
            "first: values of 0 to 255 to uint8, others to float, divided by the value of white."
        )
    if images.shape[-3] not in (1, 3):
        advice = (
            channels_last_hint(images)
            or " Pass the RGB channels alone, and join the others again afterwards."
        )
        raise ValueError(
            f"images must have 3 channels (RGB) or 1 (grey); got {images.shape[-3]} in the shape "
            f"{tuple(images.shape)}.{advice}"
        )


def as_float_rgb(images: Tensor) -> Tensor:
    """Return images that `photograph` accepts as the capture's float RGB, (B, 3, H, W)."""
    check_format(images)
    return as_float(images).expand(-1, 3, -1, -1)


def as_model_takes(images: Tensor, model: object) -> Tensor:
    """Return float images in the dtype of a module's weights; for any other model as they are, but
    float64 ones in float32."""
    weight = first_weight(model) if isinstance(model, nn.Module) else None
    if weight is not None:
        return images.to(weight.dtype)
    return images.float() if images.dtype == torch.float64 else images


def model_of_photos(
    model: Callable[[Tensor], Tensor], images: Tensor
) -> Callable[[Tensor], Tensor]:
    """Return the model as a function of RGB photos (B, 3, H, W): where the images (B, C, H, W), one
    or more of any accepted type, are grey and the model takes one channel, of the photos' luma."""
    if images.shape[-3] != 1:
        return model
    grey = as_model_takes(as_float(images[:1]), model)
    try:
        with in_evaluation_mode(model), torch.no_grad():
            model(grey.clone())
    except Exception:  # which one depends on the model
        return model

    def of_luma(photos: Tensor) -> Tensor:
        return model(luma(photos))

    of_luma.rejects = rejects_of(model)  # type: ignore[attr-defined]
    return of_luma


def as_input(photo: Tensor, images: Tensor) -> Tensor:
    """Return a photo (B, 3, H, W) with the channels, dtype and memory layout of its images."""
    if images.shape[-3] == 1:
        photo = luma(photo)
    if images.dtype == torch.uint8:
        photo = (photo * 255).round_()
    photo = photo.to(images.dtype)
    if images.is_contiguous(memory_format=torch.channels_last) and not images.is_contiguous():
        return photo.contiguous(memory_format=torch.channels_last)
    return photo


def photograph(images: Tensor, shot: Shot | MixedShot, noise: Tensor | None = None) -> Tensor:
    """Return the photos of images, in their dtype, computed in float32. Differentiable in
    floating-point images.

    images: (B, C, H, W), C = 3 for RGB or 1 for grey, which is shown as grey RGB and returned as
        the photo's luma; uint8, or floating point in [0, 1]. Not modified. Others are refused, as
        in `moireaug.common.image_checks`.
    shot: one draw for B images of this size, of a scene or a mixture.
    noise: an attacker's, on the raw reading; see `capture`, also for errors.
    """
    check_format(images)
    rgb = images.expand(-1, 3, -1, -1)
    if images.dtype == torch.uint8:
        check_shape(rgb)
    else:
        rgb = check_images(rgb)
    if rgb.dtype == torch.float64:  # as of `image / 255.`: kernels take float32
        rgb = rgb.float()
    return as_input(photo_of(rgb, shot, noise), images)


def move_boxes(boxes: Tensor, shot: Shot | MixedShot) -> Tensor:
    """Return boxes (N, 4) of one image, x1, y1, x2, y2 in pixels, float, as those that enclose the
    same things in its photo, and may reach out of it. Edges may bend: points along them move."""
    t = torch.linspace(0, 1, EDGE_POINTS, dtype=torch.float64, device=boxes.device)
    zero, one = torch.zeros_like(t), torch.ones_like(t)
    x = torch.cat([t, one, t, zero])
    y = torch.cat([zero, t, one, t])
    low, high = boxes[:, None, :2].double(), boxes[:, None, 2:].double()
    points = low + (high - low) * torch.stack([x, y], -1)
    moved = shot.to_photo(points.reshape(1, -1, 2)).reshape(points.shape)
    return torch.cat([moved.amin(1), moved.amax(1)], -1).to(boxes.dtype)
