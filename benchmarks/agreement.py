"""On what share of the pictures does a classifier give the same answer for a photo as for its
original: for real photos, and for simulated ones of the same pictures?

A scene that shows a screen as real ones are keeps as many answers as the real photos do, whether
the original is photographed at its own size or shrunk before. Originals that are hardly changed say
how steady the answers are.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torchvision.transforms.v2.functional import gaussian_blur, resize

from benchmarks import measure
from moireaug import Scene, capture
from moireaug.evaluation.statistics import wilson
from moireaug.mixtures import Mixture, sample_one
from moireaug.synthesis import without_moire
from training.data.real_pairs import ScreenPhoto
from training.models import classifiers as models

CLASSES = 1000  # of ImageNet


@dataclass(frozen=True)
class Sizes:
    """Sides in pixels: of the square pictures that classifiers see, and of those that originals are
    shrunk to before they are photographed."""

    judged: int = 224
    shrunk: tuple[int, ...] = (224,)


class Kind(NamedTuple):
    """A kind of photo: the scene that made it, and the original that was shown."""

    scene: str
    shown: str


REAL_PHOTOS = Kind("the real photos", "a screen")
ORIGINALS = "the originals"  # shrunk, and not photographed
SMALL_CHANGES: dict[str, Callable[[Tensor], Tensor]] = {  # of pictures (1, 3, S, S)
    "moved by 2 px": lambda small: small.roll((2, 2), (-2, -1)),
    "blurred by 0.7 px": lambda small: gaussian_blur(small, [5, 5], [0.7, 0.7]),
}
Answers = dict[tuple[str, Kind], list[bool]]  # whether each is kept, by classifier and kind


def read_classifiers(folder: Path) -> dict[str, nn.Module]:
    """Read the ImageNet classifiers of a folder, which take images in [0, 1].

    Args:
        folder: holds state_dicts named as torchvision's models, such as resnet18.pth.

    Raises:
        ValueError: no such files, a name that torchvision does not know, or weights of another
            model.
    """
    files = sorted(folder.glob("*.pth"))
    if not files:
        raise ValueError(
            f"there are no classifiers in {folder}: put state_dicts there that are named as "
            "torchvision's models, such as resnet18.pth."
        )
    classifiers = {}
    for file in files:
        classifiers[file.stem] = models.as_model(file.stem, CLASSES, str(file), whole=True).eval()
    return classifiers


@torch.no_grad()
def answers_kept(
    classifiers: Mapping[str, nn.Module],
    pairs: Iterable[ScreenPhoto],
    chosen: Mapping[str, Scene | Mixture],
    sizes: Sizes,
) -> Answers:
    """Return whether each classifier's answer for each photo is the one for its original.

    Args:
        classifiers: of images in [0, 1], by name.
        pairs: real photos with their originals.
        chosen: scenes, and mixtures of them, by name.
    """
    answers: Answers = {}
    for index, (_, photo, original) in enumerate(pairs):
        assert original is not None
        pictures = {REAL_PHOTOS: photo[None] / 255}
        for side in sizes.shrunk:
            pictures[Kind(ORIGINALS, f"shrunk to {side} px")] = shrunk(original[None] / 255, side)
        small = shrunk(original[None] / 255, sizes.judged)
        for name, change in SMALL_CHANGES.items():
            pictures[Kind(ORIGINALS, name)] = change(small)
        for name, scene in chosen.items():
            for shown, simulated in simulated_photos(scene, original, sizes.shrunk, index):
                pictures[Kind(name, shown)] = simulated
        for_original = judged(classifiers, original[None] / 255, sizes.judged)
        for kind, picture in pictures.items():
            for name, answer in judged(classifiers, picture, sizes.judged).items():
                answers.setdefault((name, kind), []).append(answer == for_original[name])
    return answers


def simulated_photos(
    scene: Scene | Mixture, original: Tensor, sides: Sequence[int], seed: int
) -> Iterator[tuple[str, Tensor]]:
    """Photograph an original (3, H, W) uint8: at its own size, with a twin without moiré, and
    shrunk to squares of some sides first, all with the same draw."""
    whole = original[None] / 255
    for side in (None, *sides):
        shown = whole if side is None else shrunk(whole, side)
        size = (shown.shape[-2], shown.shape[-1])
        shot = sample_one(scene, size, torch.Generator().manual_seed(seed))
        if side is None:
            yield "its own size", capture(shown, shot)
            yield "its own size, no moiré", capture(shown, without_moire(shot))
        else:
            yield f"shrunk to {side} px", capture(shown, shot)


def shrunk(picture: Tensor, side: int) -> Tensor:
    """Return a picture (1, 3, H, W) as a square, without aliases."""
    return resize(picture, [side, side], antialias=True).clamp(0, 1)


def judged(classifiers: Mapping[str, nn.Module], picture: Tensor, side: int) -> dict[str, int]:
    """Return every classifier's answer for a picture (1, 3, H, W) in [0, 1]."""
    small = shrunk(picture, side)
    return {name: int(network(small)[0].argmax()) for name, network in classifiers.items()}


def rows_of(answers: Answers) -> list[dict[str, Any]]:
    """Return a row for each classifier and kind of photo: how many answers were kept, with a 95 %
    interval of their share, and how they go together with those for the real photos."""
    rows = []
    for (classifier, kind), kept in answers.items():
        low, high = wilson(sum(kept), len(kept))
        row: dict[str, Any] = {"classifier": classifier} | kind._asdict()
        row |= {"kept": sum(kept), "pictures": len(kept), "share": sum(kept) / len(kept)}
        row |= {"low": low, "high": high, "phi": None}
        if kind != REAL_PHOTOS:
            row["phi"] = phi_coefficient(answers[classifier, REAL_PHOTOS], kept)
        rows.append(row)
    return sorted(rows, key=lambda row: row["classifier"])


def phi_coefficient(ours: Sequence[bool], theirs: Sequence[bool]) -> float | None:
    """Return the correlation of two outcomes on the same pictures, in [-1, 1]; None where either is
    the same on all of them."""
    outcomes = list(zip(ours, theirs, strict=True))
    both, neither = outcomes.count((True, True)), outcomes.count((False, False))
    alone, other = outcomes.count((True, False)), outcomes.count((False, True))
    margins = (both + alone) * (neither + other) * (both + other) * (neither + alone)
    return (both * neither - alone * other) / math.sqrt(margins) if margins else None


def agree(
    classifiers: Mapping[str, nn.Module],
    pairs: Iterable[ScreenPhoto],
    chosen: Mapping[str, Scene | Mixture],
    sizes: Sizes,
) -> list[dict[str, Any]]:
    """Measure, print and return the rows; arguments as in `answers_kept`."""
    began = time.perf_counter()
    rows = rows_of(answers_kept(classifiers, pairs, chosen, sizes))
    took = time.perf_counter() - began
    print(f"Answers kept, of {rows[0]['pictures']} pictures, {took:.0f} s; phi is the correlation")
    print("with the answers kept for the real photos, picture by picture")
    print(measure.text_of_rows(rows), end="\n\n", flush=True)
    return rows
