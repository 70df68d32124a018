"""Data sets by name: uint8 images (3, size, size) and labels, split into train, val and test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
import torchvision
from torch import Tensor
from torch.utils.data import Dataset, Subset, TensorDataset
from torchvision.datasets import ImageFolder
from torchvision.transforms import v2

from moireaug.images import read
from moireaug.scene.fields import one_of
from training import signs
from training.augmentation import AUGMENT
from training.files import read_table
from training.schema import DATA, Data

IMAGENET = 1000  # classes of torchvision's published weights, which a class_index refers to
HELD_BYTES = 1 << 30  # of decoded images that are kept


class Splits(NamedTuple):
    """Three data sets of (uint8 image, label), the classes' names, and the number of classes of a
    model for them."""

    train: Dataset
    val: Dataset
    test: Dataset
    classes: dict[int, str]
    num_classes: int


class Held(Dataset):
    """Keeps the images of a data set in memory once they are read, for later epochs."""

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self.items: dict[int, tuple[Tensor, int]] = {}

    def __len__(self) -> int:
        return len(self.data)  # type: ignore[arg-type]

    def __getitem__(self, index: int) -> tuple[Tensor, int]:
        if index not in self.items:
            self.items[index] = self.data[index]
        return self.items[index]


def _held(data: Dataset, cfg: Data) -> Dataset:
    """Keep a data set in memory if it is small and no workers, which share no memory, read it."""
    size = len(data) * 3 * cfg.size**2  # type: ignore[arg-type]
    return data if cfg.workers or size > HELD_BYTES else Held(data)


def _resize(size: int) -> v2.Compose:
    """Resize the shorter side to `size` and cut out the centre: as ImageNet models are
    evaluated, without the margin of the usual 256 px."""
    return v2.Compose([v2.Resize(size, antialias=True), v2.CenterCrop(size), v2.PILToTensor()])


def _take(data: Dataset, n: int | None, seed: int = 0) -> Dataset:
    """Return a fixed random subset of n items; all of them if n is None or not smaller."""
    if n is None or n >= len(data):  # type: ignore[arg-type]
        return data
    order = torch.randperm(len(data), generator=torch.Generator().manual_seed(seed))  # type: ignore[arg-type]
    return Subset(data, order[:n].tolist())


def _split(data: Dataset, cfg: Data) -> tuple[Dataset, Dataset]:
    """Return the training images, and a fixed random part held out for validation.

    Raises:
        ValueError: either of them would be empty.
    """
    total = len(data)  # type: ignore[arg-type]
    held = cfg.val if cfg.val is not None else max(1, total // 10)
    if not 0 < held < total:
        raise ValueError(
            f"data.val must be at least 1 and leave training images; got {held} of {total}. "
            "Pass another data.val=N."
        )
    order = torch.randperm(total, generator=torch.Generator().manual_seed(0)).tolist()
    return _take(Subset(data, order[held:]), cfg.train), Subset(data, order[:held])


def _signs(cfg: Data) -> Splits:
    made = {}
    for split in signs.SPLITS:
        n = getattr(cfg, split)
        if n is None:
            n = getattr(DATA["signs"], split)
        made[split] = TensorDataset(*signs.make(split, n, size=cfg.size))
    classes = dict(enumerate(signs.CLASSES))
    return Splits(made["train"], made["val"], made["test"], classes, len(classes))


def _torchvision(make: Callable[..., Dataset], test: dict, train: dict) -> Callable[[Data], Splits]:
    def load(cfg: Data) -> Splits:
        if not cfg.root:
            raise ValueError(
                f"data={cfg.name} needs data.root=DIR, the folder where torchvision has put the "
                "data set, or puts it with data.download=true."
            )
        try:
            sets = [
                make(cfg.root, transform=_resize(cfg.size), download=cfg.download, **split)
                for split in (train, test)
            ]
        except (RuntimeError, OSError) as error:
            raise ValueError(
                f"The data set {cfg.name!r} was not found under data.root={cfg.root!r} ({error}). "
                "Pass data.download=true to fetch it, or as data.root the folder where torchvision "
                "has put it."
            ) from error
        names = getattr(sets[1], "classes", None) or [str(i) for i in range(43)]
        known, seen = _held(sets[0], cfg), _held(sets[1], cfg)
        return Splits(
            *_split(known, cfg), _take(seen, cfg.test), dict(enumerate(names)), len(names)
        )

    return load


def _folder(cfg: Data) -> Splits:
    if not cfg.root:
        raise ValueError(
            "data=folder needs data.root=DIR, a folder with train/ and test/ inside it."
        )
    root = Path(cfg.root)
    if not root.is_dir():
        raise ValueError(
            f"data.root={cfg.root!r} is not a folder. Pass data.root=DIR with train/ and test/ "
            f"inside it."
        )
    # class folders alone: all of it is test data
    halves = [root / "train", root / "test"] if (root / "train").is_dir() else [root, root]
    try:
        sets = [ImageFolder(half, transform=_resize(cfg.size), loader=read) for half in halves]
    except (FileNotFoundError, RuntimeError) as error:
        raise ValueError(
            f"data.root={cfg.root!r} does not look like an image folder: {error}. "
            "It must hold train/<class>/ and test/<class>/, or <class>/ alone for a re-attack, "
            "with images inside."
        ) from error
    # with data.class_index, a class need not be in both halves
    numbers = [_numbers(half.classes, cfg) for half in sets]
    if numbers[0] != numbers[1] and not cfg.class_index:
        odd = sorted(set(sets[0].classes) ^ set(sets[1].classes))
        raise ValueError(
            f"train/ and test/ under {cfg.root!r} must hold the same class folders; these "
            f"differ: {odd[:5]}."
        )
    for half, index in zip(sets, numbers, strict=True):
        half.target_transform = [index[name] for name in half.classes].__getitem__
    known, seen = _held(sets[0], cfg), _held(sets[1], cfg)
    train, val = _split(known, cfg) if halves[0] != halves[1] else (known, known)
    classes = {number: name for index in numbers for name, number in index.items()}
    return Splits(
        train, val, _take(seen, cfg.test), classes, IMAGENET if cfg.class_index else len(classes)
    )


def _numbers(names: list[str], cfg: Data) -> dict[str, int]:
    """Return the class of each folder: its place in the order, or what the CSV says."""
    if not cfg.class_index:
        return {name: i for i, name in enumerate(names)}
    known = _class_index(Path(cfg.class_index))
    lost = [n for n in names if known.get(n, IMAGENET) >= IMAGENET]
    if lost:
        raise ValueError(
            f"{cfg.class_index} names no class_index below {IMAGENET} for the folders {lost[:5]} "
            f"of {cfg.root!r}: add them."
        )
    return {name: known[name] for name in names}


def _class_index(path: Path) -> dict[str, int]:
    """Return folder name to class index, from a CSV with the columns folder (or wnid) and
    class_index."""
    try:
        rows = read_table(path)
        return {row.get("folder") or row["wnid"]: int(row["class_index"]) for row in rows}
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise ValueError(
            f"data.class_index={str(path)!r} could not be read ({error!r}). It must be a CSV file "
            "with a header and the columns folder (or wnid) and class_index, one row per folder."
        ) from error


LOADERS: dict[str, Callable[[Data], Splits]] = {
    "signs": _signs,
    "cifar10": _torchvision(torchvision.datasets.CIFAR10, {"train": False}, {"train": True}),
    "cifar100": _torchvision(torchvision.datasets.CIFAR100, {"train": False}, {"train": True}),
    "gtsrb": _torchvision(torchvision.datasets.GTSRB, {"split": "test"}, {"split": "train"}),
    "folder": _folder,
}


def load(cfg: Data) -> Splits:
    """Load the data set that `cfg.name` names.

    Raises:
        ValueError: an unknown name or augmentation, a missing folder, folders that do not fit; says
            what to do.
    """
    one_of("data.augment", cfg.augment, AUGMENT)
    return LOADERS[one_of("data", cfg.name, LOADERS)](cfg)


def require_training_images(cfg: Data) -> None:
    """Refuse a folder of class folders alone, all of which are test images.

    Raises:
        ValueError: with what to do.
    """
    if cfg.name != "folder" or not cfg.root or not Path(cfg.root).is_dir():
        return
    if not (Path(cfg.root) / "train").is_dir():
        raise ValueError(
            f"data.root={cfg.root!r} has no folder train/, so that all its images are for testing. "
            "Training needs train/<class>/ and test/<class>/ in it; to attack given weights on "
            "these images, use training/reattack.py."
        )
