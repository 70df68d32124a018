"""Does tuning on simulated photos help a classifier on real photos of screens?

    python benchmarks/fine_tuning.py PAIRS.csv --images DIR --classifiers DIR
    python benchmarks/fine_tuning.py PAIRS.csv --loose PAIRS2.csv --images DIR --classifiers DIR

Each ImageNet classifier is tuned by the recipe moire_tune on a folder of pictures without labels:
it learns to answer photographed pictures as it answered the pictures before. Controls take the
photos' place: their twins without moiré (blur, tone and noise alone), blur with JPEG and changed
colours, and sinusoids. No training sees a real photo.

Prints on what share of the pairs in PAIRS.csv (columns photo and original, aligned) a network
answers the original as before, and the real photo as the original: as its own answer to it, and as
the one before; for whole pictures, and for the middle of each at native pixels. Pairs of --loose
show one object without being aligned, and are judged whole. Each network is judged as trained, and
averaged with the original as the recipe would. Writes results/fine_tuning.csv.
"""

from __future__ import annotations

import copy
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
from hydra import compose, initialize
from torch import Tensor, nn
from torchvision.transforms import v2

from benchmarks import measure
from benchmarks.agreement import CLASSES, read_classifiers, shrunk
from benchmarks.other_libraries import overlay
from moireaug.evaluation.statistics import wilson
from training.classifier.adversaries import TrainingAdversary
from training.classifier.original import keep_answers
from training.classifier.train import classifier_of, train_model
from training.config.compose import RECIPE_GROUPS, register
from training.config.schema import Config, as_config
from training.data.real_pairs import find_pairs, read_codes
from training.data.splits import Splits
from training.recipe.phases import load_data
from training.runs.run import Run

Photograph = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Effort:
    """Side of the pictures in pixels; training pictures of an epoch, and epochs."""

    side: int = 224
    train: int = 3200
    epochs: int = 5


QUICK_SETTINGS = Effort(side=64, train=4, epochs=1)


class Treatment(NamedTuple):
    """What takes half of each batch: photos in a scene, with moiré or without, or images that a
    function changes in their place."""

    scene: str = "anywhere"
    moire: bool = True
    photograph: Photograph | None = None


class Judged(NamedTuple):
    """Originals and real photos, each (N, 3, S, S) uint8."""

    originals: Tensor
    photos: Tensor


class Rival(TrainingAdversary):
    """Changes images in place of photographing them.

    Args:
        change: of images (B, 3, H, W) in [0, 1].
    """

    def __init__(self, change: Photograph) -> None:
        self.change, self.attack = change, None

    def photograph(self, images: Tensor) -> Tensor:
        return self.change(images)


def degrade(images: Tensor) -> Tensor:
    """Blur images, change their colours and compress them, each by draws of its own."""
    change = v2.Compose(
        [v2.GaussianBlur(5, (0.1, 2.0)), v2.ColorJitter(0.4, 0.4, 0.4, 0.05), v2.JPEG((40, 90))]
    )
    codes = (255 * images).round().to(torch.uint8)
    return torch.stack([change(one) for one in codes]) / 255


TREATMENTS: dict[str, Treatment] = {
    "anywhere": Treatment(),
    "anywhere without moiré": Treatment(moire=False),
    "screen_photo": Treatment("screen_photo"),
    "screen_photo without moiré": Treatment("screen_photo", moire=False),
    "blur, colour and JPEG": Treatment(photograph=degrade),
    "a sinusoid in each colour": Treatment(photograph=overlay),
}


def settings_of(treatment: Treatment, weights: Path, images: Path, effort: Effort) -> Config:
    """Return the settings of the recipe for one network and treatment."""
    register("fine_tuning", Config, RECIPE_GROUPS, None)
    with initialize(version_base="1.3", config_path=None):
        cfg = as_config(compose("fine_tuning", ["recipe=moire_tune", "data=folder"]))
    data = replace(cfg.data, root=str(images), size=effort.side, train=effort.train)
    return replace(
        cfg,
        model=weights.stem,
        weights=str(weights),
        scene=treatment.scene,
        data=data,
        adversary=replace(cfg.adversary, moire=treatment.moire),
        train=replace(cfg.train, epochs=effort.epochs),
    )


def tuned(cfg: Config, splits: Splits, photograph: Photograph | None) -> dict[float, nn.Module]:
    """Return a network tuned by the recipe, by the share of its new weights: 1, and the share that
    keeps `train.kept` of its answers."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(replace(cfg, runs=folder, train=replace(cfg.train, kept=0.0)))
        run.prepare()
        classifier = classifier_of(run.config, splits.num_classes)
        assert classifier.original
        if photograph:
            classifier.adversary = classifier.validation_adversary = Rival(photograph)
        _, cost = train_model(run, splits, classifier=classifier)
        model = classifier.model.eval()
        students = {1.0: copy.deepcopy(model)}
        share = keep_answers(model, classifier.original, splits.val, cfg.train.kept).new_share
    print(f"{cfg.model}: {cost.wall_seconds:.0f} s, {share:.0%} new", file=sys.stderr, flush=True)
    return students | {share: model}


def read_pictures(table: Path, side: int, *, aligned: bool) -> Iterator[tuple[str, Judged]]:
    """Read pairs whole, shrunk to squares, and aligned ones in crops, too."""
    parts: dict[str, tuple[list[Tensor], list[Tensor]]] = {}
    for pair in find_pairs(table):
        pictures = [read_codes(path) for path in (pair.original, pair.photo)]
        for index, picture in enumerate(pictures):
            whole = shrunk(picture[None] / 255, side)
            parts.setdefault("whole", ([], []))[index].append((255 * whole).round().byte())
            if aligned:
                crop = v2.functional.center_crop(picture, [side, side])
                parts.setdefault("crops", ([], []))[index].append(crop[None])
    for part, (originals, photos) in parts.items():
        yield f"{table.stem}, {part}", Judged(torch.cat(originals), torch.cat(photos))


@torch.no_grad()
def answers(classifier: nn.Module, pictures: Tensor) -> Tensor:
    """Return the classes (N,) that a classifier gives pictures (N, 3, S, S) uint8."""
    return torch.cat([classifier(part / 255).argmax(1) for part in pictures.split(32)])


def row_of(before: Tensor, student: nn.Module, pictures: Judged) -> dict[str, Any]:
    """Return shares of equal answers, with 95 % intervals.

    Args:
        before: (N,) the answers of the classifier before training to the originals.
    """
    own, of_photos = answers(student, pictures.originals), answers(student, pictures.photos)
    row: dict[str, Any] = {"n": len(before)}
    for kind, same in (
        ("original as before", own == before),
        ("photo as original", of_photos == own),
        ("photo as original before", of_photos == before),
    ):
        row[kind] = same.double().mean().item()
        row[f"{kind}, low"], row[f"{kind}, high"] = wilson(int(same.sum()), len(same))
    return row


def rows_of(
    name: str, students: Mapping[tuple[str, float], nn.Module], judged: Mapping[str, Judged]
) -> list[dict[str, Any]]:
    """Return a row for each training of a classifier, share of its new weights and kind of pairs.
    The first student is the classifier before training."""
    teacher = next(iter(students.values()))
    rows = []
    for pairs, pictures in judged.items():
        before = answers(teacher, pictures.originals)
        for (training, share), student in students.items():
            row = {"classifier": name, "pairs": pairs, "tuned on": training, "new": share}
            rows.append(row | row_of(before, student, pictures))
    return rows


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("pairs", type=Path, help="a CSV file with the columns photo and original")
    parser.add_argument("--loose", type=Path, help="one of pairs that are not aligned")
    parser.add_argument("--images", type=Path, required=True, help="clean pictures to train on")
    parser.add_argument(
        "--classifiers", type=Path, required=True, help="a folder of files such as resnet18.pth"
    )
    parser.add_argument("--pictures", type=int, help="of an epoch, instead of the recipe's")
    parser.add_argument("--epochs", type=int, help="instead of the recipe's")
    parser.add_argument("--only", nargs="+", choices=TREATMENTS, default=list(TREATMENTS))
    args, effort, _ = measure.begin(parser, Effort(), QUICK_SETTINGS)
    for name, value in (("train", args.pictures), ("epochs", args.epochs)):
        effort = effort if value is None else replace(effort, **{name: value})
    try:
        teachers = read_classifiers(args.classifiers)
        judged = dict(read_pictures(args.pairs, effort.side, aligned=True))
        if args.loose:
            judged |= dict(read_pictures(args.loose, effort.side, aligned=False))
        rows = tune_and_judge(args, teachers, judged, effort)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    measure.publish(pd.DataFrame(rows), measure.results(args) / "fine_tuning.csv")


def tune_and_judge(
    args: Any, teachers: Mapping[str, nn.Module], judged: Mapping[str, Judged], effort: Effort
) -> Sequence[dict[str, Any]]:
    """Tune each classifier in every way, and return the rows of all."""
    rows = []
    for name, teacher in teachers.items():
        students: dict[tuple[str, float], nn.Module] = {("nothing", 0.0): teacher}
        weights = args.classifiers / f"{name}.pth"
        for training in args.only:
            treatment = TREATMENTS[training]
            cfg = settings_of(treatment, weights, args.images, effort)
            splits = load_data(cfg)
            assert splits.num_classes == CLASSES
            for share, student in tuned(cfg, splits, treatment.photograph).items():
                students[training, share] = student
        rows += rows_of(name, students, judged)
    return rows


if __name__ == "__main__":
    main()
