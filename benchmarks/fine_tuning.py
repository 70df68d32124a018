"""Does training on simulated photos help a classifier on real photos of screens?

    python benchmarks/fine_tuning.py PAIRS.csv --images DIR --classifiers DIR

Each ImageNet classifier is fine-tuned on a folder of clean pictures, without labels: it learns to
give photographed crops the answers that it gave the clean crops before. Half of every batch are
clean crops; the other half are more of them (a control), their photos without moiré (a control:
blur, tone and noise alone), or their photos. No training sees a real photo.

Prints, for the pictures in PAIRS.csv (columns photo and original, aligned), on what share a network
answers the original as before training, and the real photo as the original: as its own answer to
it, and as the one before training. Writes results/fine_tuning.csv.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from torch import Tensor, nn
from torch.nn.functional import kl_div
from torchvision.transforms.v2 import RandomHorizontalFlip, RandomResizedCrop

from benchmarks import measure
from benchmarks.agreement import read_classifiers, shrunk
from moireaug import capture
from moireaug.evaluation.statistics import wilson
from moireaug.mixtures import as_scenes
from moireaug.synthesis import without_moire
from training.data.real_pairs import find_images, find_pairs, read_codes, read_pairs

LEARNING_RATE = 0.001
MAX_GRADIENT_NORM = 1.0
Photograph = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Effort:
    """Optimiser steps, pictures a step, and the side of crops and judged pictures in pixels."""

    steps: int = 200
    batch: int = 16
    side: int = 224


QUICK_SETTINGS = Effort(steps=2, batch=2, side=64)


def photographer(scene: str, *, moire: bool) -> Photograph:
    """Return a function that photographs images (B, 3, S, S) in [0, 1], each in a draw of its
    own."""
    scenes = as_scenes(scene)

    def photograph(images: Tensor) -> Tensor:
        shot = scenes.sample(len(images), (images.shape[-2], images.shape[-1]))
        return capture(images, shot if moire else without_moire(shot))

    return photograph


TRAININGS: dict[str, Photograph] = {
    "the pictures alone": lambda images: images,
    "screen_photo without moiré": photographer("screen_photo", moire=False),
    "screen_photo": photographer("screen_photo", moire=True),
    "anywhere": photographer("anywhere", moire=True),
}


def read_crops(folder: Path, side: int) -> Callable[[int], Tensor]:
    """Return a function that cuts n random crops (n, 3, side, side) in [0, 1] of the pictures of a
    folder, half of them mirrored."""
    pictures = [read_codes(path) for path in find_images(folder)]
    cut, mirror = RandomResizedCrop(side, (0.3, 1.0), antialias=True), RandomHorizontalFlip()

    def crops(n: int) -> Tensor:
        chosen = torch.randint(len(pictures), (n,)).tolist()
        return torch.stack([mirror(cut(pictures[k])) for k in chosen]) / 255

    return crops


def trained(
    teacher: nn.Module, crops: Callable[[int], Tensor], photograph: Photograph, effort: Effort
) -> nn.Module:
    """Return a copy of a classifier that was trained to answer photographed crops, and the crops,
    as it answered the crops before. Its batch statistics stay."""
    student = copy.deepcopy(teacher).eval()
    # Adam would blow up the rounding errors that are the control's only gradient
    optimizer = torch.optim.SGD(student.parameters(), LEARNING_RATE, momentum=0.9)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, LEARNING_RATE, total_steps=effort.steps
    )
    for _ in range(effort.steps):
        clean = crops(effort.batch)
        with torch.no_grad():
            wanted = teacher(clean).log_softmax(1)
        half = effort.batch // 2
        shown = torch.cat([clean[:half], photograph(clean[half:])])
        loss = kl_div(student(shown).log_softmax(1), wanted, reduction="batchmean", log_target=True)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(student.parameters(), MAX_GRADIENT_NORM)
        optimizer.step()
        schedule.step()
    return student


@torch.no_grad()
def answers(classifier: nn.Module, pictures: Tensor) -> Tensor:
    """Return the classes (N,) that a classifier gives pictures (N, 3, S, S)."""
    return torch.cat([classifier(part).argmax(1) for part in pictures.split(32)])


def rows_of(
    name: str, students: Mapping[str, nn.Module], originals: Tensor, photos: Tensor
) -> list[dict[str, Any]]:
    """Return a row per training of a classifier: shares of equal answers, with 95 % intervals. The
    first student is the classifier before training."""
    before = answers(next(iter(students.values())), originals)
    rows = []
    for training, student in students.items():
        own, of_photos = answers(student, originals), answers(student, photos)
        row: dict[str, Any] = {"classifier": name, "trained on": training, "n": len(before)}
        for kind, same in (
            ("original as before", own == before),
            ("photo as original", of_photos == own),
            ("photo as original before", of_photos == before),
        ):
            row[kind] = same.double().mean().item()
            row[f"{kind}, low"], row[f"{kind}, high"] = wilson(int(same.sum()), len(same))
        rows.append(row)
    return rows


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("pairs", type=Path, help="a CSV file with the columns photo and original")
    parser.add_argument("--images", type=Path, required=True, help="clean pictures to train on")
    parser.add_argument(
        "--classifiers", type=Path, required=True, help="a folder of files such as resnet18.pth"
    )
    args, effort, _ = measure.begin(parser, Effort(), QUICK_SETTINGS)
    try:
        teachers = read_classifiers(args.classifiers)
        crops = read_crops(args.images, effort.side)
        pairs = list(read_pairs(find_pairs(args.pairs)))
    except (ValueError, OSError) as error:
        parser.error(str(error))
    photos = torch.cat([shrunk(pair.photo[None] / 255, effort.side) for pair in pairs])
    originals = torch.cat([shrunk(pair.original[None] / 255, effort.side) for pair in pairs])
    rows = []
    for name, teacher in teachers.items():
        students = {"as it was": teacher}
        for training, photograph in TRAININGS.items():
            torch.manual_seed(0)
            students[training] = trained(teacher, crops, photograph, effort)
            print(f"{name}: trained on {training}", file=sys.stderr, flush=True)
        rows += rows_of(name, students, originals, photos)
    measure.publish(pd.DataFrame(rows), measure.results(args) / "fine_tuning.csv")


if __name__ == "__main__":
    main()
