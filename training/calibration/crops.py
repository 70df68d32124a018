"""Crops of real photos and their originals, and their photos by a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from moireaug import Scene, capture
from training.data.real_pairs import ScreenPhoto

BATCH_CROPS = 8  # that are photographed at a time


@dataclass(frozen=True, eq=False)
class Crops:
    """Crops at the same places of photos and originals.

    Args:
        photos: (N, 3, S, S) uint8.
        originals: (N, 3, S, S) uint8 of the originals; None where only photos are known.
        picture: (N,) int64 index of each crop's picture.
        names: names of the pictures.
    """

    photos: Tensor
    originals: Tensor | None
    picture: Tensor
    names: tuple[str, ...]


def cut_crops(pictures: Iterable[ScreenPhoto], side: int, each: int, seed: int = 0) -> Crops:
    """Cut `each` square crops of `side` pixels out of every picture, at random places.

    Args:
        pictures: photos, all of them with originals, or none.
        side: side of a crop, in pixels.
        each: number of crops of a picture.
        seed: seed of the places.

    Raises:
        ValueError: a picture that is smaller than a crop.
    """
    draw = np.random.default_rng(seed)
    photos: list[Tensor] = []
    originals: list[Tensor] = []
    index: list[int] = []
    names: list[str] = []
    for name, photo, original in pictures:
        height, width = photo.shape[-2:]
        if min(height, width) < side:
            raise ValueError(
                f"{name} is {_size(photo)} pixels, smaller than a crop of {side}: make the crops "
                "smaller."
            )
        for _ in range(each):
            y = int(draw.integers(0, height - side + 1))
            x = int(draw.integers(0, width - side + 1))
            # a view would keep the whole photo
            photos.append(photo[:, y : y + side, x : x + side].clone())
            index.append(len(names))
            if original is not None:
                originals.append(original[:, y : y + side, x : x + side].clone())
        names.append(name)
    both = torch.stack(originals) if originals else None
    return Crops(torch.stack(photos), both, torch.tensor(index, device="cpu"), tuple(names))


def _size(picture: Tensor) -> str:
    return f"{picture.shape[-1]} x {picture.shape[-2]}"


@torch.no_grad()
def photograph_crops(scene: Scene, originals: Tensor, seed: int = 0) -> Tensor:
    """Photograph crops (N, 3, S, S) uint8 in a scene; return the photos as 8-bit codes of the same
    shape, as files hold them."""
    generator = torch.Generator().manual_seed(seed)
    height, width = originals.shape[-2:]
    shot = scene.sample(len(originals), (height, width), generator)
    photos = []
    for start in range(0, len(originals), BATCH_CROPS):
        rows = slice(start, start + BATCH_CROPS)
        photos.append(capture(originals[rows].float() / 255, shot[rows]))
    return (255 * torch.cat(photos)).round().clamp(0, 255).to(torch.uint8)
