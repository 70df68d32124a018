"""Photos in folders that say whether they are of screens."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from tqdm import tqdm

from moireaug.common.image_files import read_picture
from moireaug.synthesis.pictures import Pictures
from training.detection.heads import LOOKS, Heads, Part, Parts
from training.detection.network import Detector, as_photo

LABELS = {"real": False, "screen": True}  # names of folders, or their first word
MAX_FOLDS = 5


def truth_of(name: str) -> bool | None:
    """Return whether a photo lies in a folder of screens, or None in one of neither kind."""
    for part in reversed(PurePosixPath(name.lower()).parts[:-1]):
        word = re.match(r"(real|screen)s?(?![a-z])", part)  # no phone by Realme, no screenshots
        if word:
            return LABELS[word[1]]
    return None


def collection_of(name: str) -> str:
    """Return the folder of the top that a photo lies in; "" where that is one of a label."""
    parts = PurePosixPath(name).parts
    return parts[0] if truth_of(f"{parts[0]}/photo") is None and len(parts) > 1 else ""


def readable(folder: Path, names: Iterable[str]) -> Iterator[tuple[str, Image.Image]]:
    """Yield the photos of a folder with their names; those that cannot be read are named and left
    out."""
    for name in names:
        try:
            picture = read_picture(folder / name)
        except ValueError as error:
            print(f"left out: {error}")
            continue
        yield name, picture


class LabelledPhotos(NamedTuple):
    """What a detector's heads see of N photos whose truth is known.

    names: in their folder. crops: features (N, crops, F). wholes: (N, F). is_screen: (N,) bool.
    """

    names: list[str]
    crops: Tensor
    wholes: Tensor
    is_screen: Tensor

    def subset(self, chosen: Tensor) -> LabelledPhotos:
        """Return some of the photos, by (N,) bool."""
        names = [name for name, is_chosen in zip(self.names, chosen, strict=True) if is_chosen]
        return LabelledPhotos(
            names, self.crops[chosen], self.wholes[chosen], self.is_screen[chosen]
        )

    def part(self, look: str) -> Part:
        """Return features (M, F) of a look, and whether each is a screen (M,)."""
        if look == "whole":
            return self.wholes, self.is_screen
        return self.crops.flatten(0, 1), self.is_screen.repeat_interleave(self.crops.shape[1])


@torch.no_grad()
def read_labelled(detector: Detector, folder: str | Path) -> LabelledPhotos:
    """Read the photos of a folder that lie in folders of a label; those that cannot be read are
    named and left out.

    Raises:
        ValueError: no such folder, or not both screens and others in it.
    """
    pictures = Pictures(folder, 1)
    names, crops, wholes = [], [], []
    labelled = [name for name in pictures.names if truth_of(name) is not None]
    require_both_kinds(labelled, folder)
    progress = tqdm(labelled, unit="photo", disable=None)
    for name, picture in readable(pictures.folder, progress):
        seen = detector.seen(as_photo(picture))
        names.append(name)
        crops.append(seen["crop"])
        wholes.append(seen["whole"])
    require_both_kinds(names, folder)
    is_screen = torch.tensor([bool(truth_of(name)) for name in names])
    return LabelledPhotos(names, torch.cat(crops), torch.cat(wholes), is_screen)


def require_both_kinds(names: Iterable[str], folder: str | Path) -> None:
    """Refuse labelled photos of which none is a screen, or all are."""
    kinds = Counter(truth_of(name) for name in names)
    if len(kinds) < len(LABELS):
        counts = " and ".join(f"{kinds[truth]} in {label}" for label, truth in LABELS.items())
        raise ValueError(
            f"labelled photos must be of both kinds; of the readable ones in {folder}, {counts} "
            "lie in folders of these names: put photos of screens into screen, others into real."
        )


def heads_of(photos: LabelledPhotos, parts: Parts, penalty: float) -> Heads:
    """Return heads that are fitted to photos and to further parts."""
    heads = Heads(photos.wholes.shape[1])
    heads.fit({look: [*parts[look], photos.part(look)] for look in LOOKS}, penalty)
    return heads


class Scores(NamedTuple):
    """Scores of photos of screens, and of others."""

    screens: np.ndarray
    others: np.ndarray


@torch.no_grad()
def cross_validated(photos: LabelledPhotos, parts: Parts, penalty: float) -> Scores | None:
    """Return the scores of photos, a fifth of them at a time by heads that are fitted to the others
    and to further parts; None where one of a kind is all there is.

    Neighbours in the folder, which may be of one scene, are left out together."""
    screens, others = photos.is_screen, ~photos.is_screen
    counts = [int(rows.sum()) for rows in (screens, others)]
    folds = min(MAX_FOLDS, *counts)
    if folds < 2:
        return None
    fold = torch.empty(len(photos.names), dtype=torch.long)
    for count, rows in zip(counts, (screens, others), strict=True):
        fold[rows] = torch.arange(count) * folds // count
    scores = torch.empty(len(photos.names))
    for number in range(folds):
        is_left_out = fold == number
        heads = heads_of(photos.subset(~is_left_out), parts, penalty)
        test = photos.subset(is_left_out)
        scores[is_left_out] = heads(test.crops, test.wholes)
    return Scores(scores[screens].numpy(), scores[others].numpy())
