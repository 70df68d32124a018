"""Augmentations of clean training images by name, each drawn per image by kornia."""

import functools

import kornia.augmentation as K
import torch
from kornia.augmentation import AugmentationSequential
from torch import Tensor


@functools.lru_cache
def pipeline(kind: str, height: int, width: int) -> AugmentationSequential:
    """Return the augmentation of that name for images of one size: "affine" is for signs and
    documents, which must not be flipped."""
    if kind == "affine":
        return AugmentationSequential(
            K.RandomAffine(15, (0.1, 0.1), (0.85, 1.15), 8, padding_mode="border", p=1.0),
            K.RandomBrightness((0.6, 1.4), p=1.0),
            K.RandomContrast((0.6, 1.4), p=1.0),
            K.RandomErasing((0.02, 0.15), (0.5, 2.0), p=0.25),
        )
    if kind == "crop_flip":
        return AugmentationSequential(
            K.RandomResizedCrop((height, width), scale=(0.5, 1.0), p=1.0),
            K.RandomHorizontalFlip(p=0.5),
        )
    reach = max(1, height // 8), max(1, width // 8)
    shift = K.RandomCrop((height, width), padding=reach, p=1.0)
    if kind == "shift":
        return AugmentationSequential(shift)
    return AugmentationSequential(shift, K.RandomHorizontalFlip(p=0.5))


def augment(images: Tensor, kind: str) -> Tensor:
    """Return a float batch (B, 3, H, W) in [0, 1], each image augmented by its own draw from
    torch's global generator; `kind` is one of `AUGMENTATIONS`."""
    if kind == "none":
        return images
    # kornia's affine transforms are off by up to a pixel in bfloat16
    with torch.no_grad(), torch.autocast(images.device.type, enabled=False):
        return pipeline(kind, *images.shape[-2:])(images)
