"""Augmentations on the field's common corruptions, on photos of screens and under attack: CIFAR-10.

    pip install --no-deps corrupt-tta     # photos of frost: without them, frost is left out
    python benchmarks/corruptions.py CIFAR10

CIFAR10 holds train/ and test/ with a folder for each class. small_resnet is trained with each
of benchmarks/augmentations.py by one schedule, and judged on clean test images; on the fifteen
corruptions of benchmarks/common_corruptions.py at five severities; on photos of screens in the
presets that no training used, as crops with 1 to 3 sensor pixels per pixel and as whole photos; and
under PGD.

Adds to results/corruptions.csv as each training ends, and leaves out those that it holds; prints
their means. `train_seconds` are those of the processor.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # run from anywhere, installed or not

import pandas as pd
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from benchmarks import measure
from benchmarks.augmentations import SCENES, SHRINK, Augmentation, augmentations
from benchmarks.common_corruptions import CORRUPTIONS, corrupt, frost, frost_photos
from moireaug import capture
from moireaug.attacks import PGD
from moireaug.evaluation.statistics import wilson
from moireaug.mixtures import as_scenes
from moireaug.scene.presets import MIXTURES
from training.classifier.muon import Muon
from training.config.data_sets import Data
from training.data.augmentation import augment
from training.data.image_sets import read
from training.models.small_resnet import SmallResNet

SIDE = 32  # of the images, in pixels
EPS, STEPS = 1 / 255, 10  # of PGD
AUGMENTED_BATCHES = 8  # that are augmented in one call
LR, MOMENTUM, DECAY = 0.02, 0.95, 0.05  # of Muon, as the recipes'


@dataclass(frozen=True)
class Effort:
    """Training images, epochs, seeds and size of a batch; test images clean, of each corruption and
    severity, of each preset, and of PGD. None: all there are."""

    train: int | None = None
    epochs: int = 8
    seeds: int = 2
    batch: int = 128
    clean: int | None = None
    corrupted: int = 1000
    photos: int = 250
    attacked: int = 500


QUICK_SETTINGS = Effort(
    40, epochs=1, seeds=1, batch=20, clean=20, corrupted=4, photos=4, attacked=4
)


class Labelled(NamedTuple):
    """Images (N, 3, H, W) uint8 and their classes (N,)."""

    images: Tensor
    labels: Tensor


class JudgedSet(NamedTuple):
    """Images to judge on: a kind, the corruption or preset, and versions of so many images."""

    kind: str
    name: str
    images: int
    data: Labelled


def train(change: Augmentation, data: Labelled, effort: Effort, seed: int) -> nn.Module:
    """Return a network trained on augmented images, in evaluation mode."""
    torch.manual_seed(seed)
    model = SmallResNet(int(data.labels.max()) + 1).to(memory_format=torch.channels_last)
    steps = effort.epochs * (len(data.labels) // effort.batch)
    optimizer = Muon(model.parameters(), LR, MOMENTUM, DECAY)
    rates = [group["lr"] for group in optimizer.param_groups]
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, rates, total_steps=max(6, steps), pct_start=0.2, max_momentum=MOMENTUM
    )
    for _ in range(effort.epochs):
        order = torch.randperm(len(data.labels))[: steps // effort.epochs * effort.batch]
        for rows in order.split(AUGMENTED_BATCHES * effort.batch):
            images = change(augment(data.images[rows] / 255, "shift_flip"))
            images = images.contiguous(memory_format=torch.channels_last)
            labels = data.labels[rows]
            for part in torch.arange(len(rows)).split(effort.batch):
                loss = F.cross_entropy(model(images[part]), labels[part])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
    return model.eval()


def test_sets(data: Labelled, effort: Effort) -> Iterator[JudgedSet]:
    """Make the sets that every network is judged on, of the first ones of the test images."""
    yield JudgedSet("clean", "", len(data.labels), data)
    part = Labelled(data.images[: effort.corrupted], data.labels[: effort.corrupted])
    seeds = itertools.count()
    for group, corruptions in CORRUPTIONS.items():
        for change, amounts in corruptions.items():
            if change is frost and not frost_photos():
                continue
            images = [corrupt(part.images, change, amount, next(seeds)) for amount in amounts]
            versions = Labelled(torch.cat(images), part.labels.repeat(len(amounts)))
            yield JudgedSet(group, change.__name__, len(part.labels), versions)
    shown, labels = data.images[: effort.photos], data.labels[: effort.photos]
    presets = [name for name in MIXTURES["anywhere"] if name not in SCENES]
    for kind, shrink in (("crops of photos", SHRINK), ("whole photos", None)):
        for k, name in enumerate(presets):
            photos = photographed(shown, name, shrink, seed=k)
            yield JudgedSet(kind, name, len(labels), Labelled(photos, labels))


def photographed(
    images: Tensor, preset: str, shrink: tuple[float, float] | None, seed: int
) -> Tensor:
    """Return photos, (N, 3, H, W) uint8, of images alike."""
    generator = torch.Generator().manual_seed(seed)
    size = images.shape[-2], images.shape[-1]
    shot = as_scenes(preset, shrink).sample(len(images), size, generator)
    return (255 * capture(images / 255, shot)).round().byte()


def accuracy(model: nn.Module, data: Labelled) -> float:
    with torch.no_grad():
        answers = [model(part / 255).argmax(1) for part in data.images.split(500)]
    return (torch.cat(answers) == data.labels).double().mean().item()


def attacked(model: nn.Module, data: Labelled) -> JudgedSet:
    """Return images under PGD."""
    attack = PGD(model, eps=EPS, steps=STEPS)
    generator = torch.Generator().manual_seed(0)
    pairs = zip(data.images.split(100), data.labels.split(100), strict=True)
    images = [attack.last(part / 255, labels, generator=generator) for part, labels in pairs]
    attacked_data = Labelled(255 * torch.cat(images), data.labels)
    return JudgedSet("PGD", f"{255 * EPS:g}/255", len(data.labels), attacked_data)


def judged(model: nn.Module, sets: Sequence[JudgedSet], effort: Effort) -> list[dict[str, Any]]:
    """Return the accuracy of a model on each set, the first of which is clean, and under attack."""
    part = Labelled(*(one[: effort.attacked] for one in sets[0].data))
    rows = []
    for kind, name, images, data in (*sets, attacked(model, part)):
        row = {"kind": kind, "name": name, "images": images, "answers": len(data.labels)}
        rows.append(row | {"accuracy": accuracy(model, data)})
    return rows


def read_part(pictures: Any, n: int | None) -> Labelled:
    """Return n images of a data set, all without n, in a random order that is always the same."""
    order = torch.randperm(len(pictures), generator=torch.Generator().manual_seed(0))[:n]
    images, labels = zip(*(pictures[k] for k in order.tolist()), strict=True)
    return Labelled(torch.stack(images), torch.tensor(labels))


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each augmentation: means over seeds and sets, in percent, with Wilson's 95 %
    interval, for which the versions of an image count once; and its training's time, next to the
    first one's."""
    times = table.groupby("augmentation", sort=False)["train_seconds"].mean()
    rows = []
    for augmentation, own in table.groupby("augmentation", sort=False):
        row = {"augmentation": augmentation, "seeds": own["seed"].nunique()}
        corrupted = own[own["kind"].isin(CORRUPTIONS)].assign(kind="corrupted")
        for kind, part in pd.concat([own, corrupted]).groupby("kind", sort=False):
            mean, images = part["accuracy"].mean(), part["images"].iloc[0]
            low, high = wilson(mean * images, images)
            row[kind] = f"{100 * mean:.1f} ({100 * low:.1f} to {100 * high:.1f})"
        rows.append(row | {"training": times[augmentation] / times.iloc[0]})
    return pd.DataFrame(rows)


def main() -> None:
    parser = measure.arguments(__doc__)
    parser.add_argument("data", type=Path, help="a folder with train/ and test/")
    parser.add_argument("--epochs", type=int)
    parser.add_argument("--seeds", type=int)
    parser.set_defaults(threads=1)
    args, effort, _ = measure.begin(parser, Effort(), QUICK_SETTINGS)
    for name in ("epochs", "seeds"):
        if getattr(args, name) is not None:
            effort = replace(effort, **{name: getattr(args, name)})
    try:
        pictures = read(Data(name="folder", root=str(args.data), size=SIDE))
        if pictures.train is None:
            raise ValueError(f"{args.data} has no train/: pass a folder with train/ and test/.")
    except ValueError as error:
        parser.error(str(error))
    data = read_part(pictures.train, effort.train)
    sets = list(test_sets(read_part(pictures.test, effort.clean), effort))
    file = measure.results(args) / "corruptions.csv"
    table = pd.read_csv(file) if file.exists() else pd.DataFrame(columns=["augmentation", "seed"])
    done = set(zip(table["augmentation"], table["seed"], strict=True))
    for seed, (name, change) in itertools.product(range(effort.seeds), augmentations().items()):
        if (name, seed) in done:
            continue
        began = time.process_time()
        model = train(change, data, effort, seed)
        facts = {"augmentation": name, "seed": seed, "epochs": effort.epochs}
        facts["train_seconds"] = time.process_time() - began
        rows = [facts | row for row in judged(model, sets, effort)]
        table = pd.concat([table, pd.DataFrame(rows)]) if len(table) else pd.DataFrame(rows)
        table.to_csv(file, index=False, float_format="%.4g")
        print(f"{name}, seed {seed}: {facts['train_seconds']:.0f} s", file=sys.stderr, flush=True)
    print(measure.text_of(summary(table)))


if __name__ == "__main__":
    main()
