"""Augmentations of clean training images by name, each drawn per image by kornia."""

import functools

import kornia.augmentation as K
import torch
from kornia.augmentation import AugmentationSequential
from torch import Tensor


@functools.lru_cache
def pipeline(kind: str, size: tuple[int, int]) -> AugmentationSequential:
    """Return the augmentation of that name for images of one size (height, width): "affine" is for
    signs and documents, which must not be flipped."""
    reach = max(1, size[0] // 8), max(1, size[1] // 8)
    shift = K.RandomCrop(size, padding=reach, p=1.0)
    flip = K.RandomHorizontalFlip(p=0.5)
    steps: dict[str, list[K.AugmentationBase2D]] = {
        "shift": [shift],
        "shift_flip": [shift, flip],
        "crop_flip": [K.RandomResizedCrop(size, scale=(0.5, 1.0), p=1.0), flip],
        "affine": [
            K.RandomAffine(15, (0.1, 0.1), (0.85, 1.15), 8, padding_mode="border", p=1.0),
            K.RandomBrightness((0.6, 1.4), p=1.0),
            K.RandomContrast((0.6, 1.4), p=1.0),
            K.RandomErasing((0.02, 0.15), (0.5, 2.0), p=0.25),
        ],
    }
    return AugmentationSequential(*steps[kind])


def augment(images: Tensor, kind: str) -> Tensor:
    """Return a float batch (B, 3, H, W) in [0, 1], each image augmented by its own draw from
    torch's global generator; `kind` is one of `AUGMENTATIONS`."""
    if kind == "none":
        return images
    # kornia's affine transforms are off by up to a pixel in bfloat16
    with torch.no_grad(), torch.autocast(images.device.type, enabled=False):
        return pipeline(kind, (images.shape[-2], images.shape[-1]))(images)
