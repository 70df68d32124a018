"""Folders of images and torchvision's data sets, as uint8 images (3, size, size)."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import os
from collections.abc import Callable
from pathlib import Path

from torch.utils.data import Dataset
from torchvision.datasets import CIFAR10, CIFAR100, GTSRB, ImageFolder
from torchvision.transforms import v2

from moireaug.images import read_picture
from moireaug.synthesis.pictures import SUFFIXES
from training.config.schema import Data
from training.data.splits import Splits, has_parts, held, split, take
from training.system.files import read_table
from training.system.locks import locked

GTSRB_CLASSES = 43  # which torchvision does not name
IMAGENET = 1000  # classes of torchvision's published weights, which a class_index refers to
# each set, and what its parts to train and to test on are called
SETS: dict[str, tuple[Callable[..., Dataset], dict, dict]] = {
    "cifar10": (CIFAR10, {"train": True}, {"train": False}),
    "cifar100": (CIFAR100, {"train": True}, {"train": False}),
    "gtsrb": (GTSRB, {"split": "train"}, {"split": "test"}),
}


def _resize(size: int) -> v2.Compose:
    """Resize the shorter side to `size` and cut out the centre: as ImageNet models are
    evaluated, without the margin of the usual 256 px."""
    return v2.Compose([v2.Resize(size, antialias=True), v2.CenterCrop(size), v2.PILToTensor()])


def published(cfg: Data) -> Splits:
    """Load one of torchvision's data sets.

    Raises:
        ValueError: no folder, or a folder without the data set; says what to do.
    """
    if not cfg.root:
        raise ValueError(
            f"data={cfg.name} needs data.root=DIR, the folder where torchvision has put the "
            "data set, or puts it with data.download=true."
        )
    make, train, test = SETS[cfg.name]
    given = {"transform": _resize(cfg.size), "download": cfg.download}
    try:
        with _alone(cfg):
            known, seen = make(cfg.root, **train, **given), make(cfg.root, **test, **given)
    except (RuntimeError, OSError) as error:
        raise ValueError(
            f"The data set {cfg.name!r} was not found under data.root={cfg.root!r} ({error}). "
            "Pass data.download=true to fetch it, or as data.root the folder where torchvision "
            "has put it."
        ) from error
    names = getattr(seen, "classes", None) or [str(i) for i in range(GTSRB_CLASSES)]
    train_part, val_part = split(held(known, cfg), cfg)
    test_part = take(held(seen, cfg), cfg.test)
    return Splits(train_part, val_part, test_part, dict(enumerate(names)), len(names))


def _alone(cfg: Data) -> contextlib.AbstractContextManager[None]:
    """Let one process at a time download into a folder; the others find the data set there."""
    if not cfg.download:
        return contextlib.nullcontext()
    os.makedirs(cfg.root or "", exist_ok=True)
    return locked(Path(cfg.root or "", ".download.lock"), "", wait_seconds=-1)


def folder(cfg: Data) -> Splits:
    """Load a folder with train/ and test/, or with class folders alone, which are all test images.

    Raises:
        ValueError: a missing folder, or folders that do not fit; says what to do.
    """
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
    if not has_parts(root):  # class folders alone: all of it is test data
        every = _pictures(root, cfg)
        classes = _label(every, cfg)
        images = held(every, cfg)
        return Splits(images, images, take(images, cfg.test), classes, _count(classes, cfg))
    known, seen = _pictures(root / "train", cfg), _pictures(root / "test", cfg)
    # with data.class_index, a class need not be in both
    if known.classes != seen.classes and not cfg.class_index:
        odd = sorted(set(known.classes) ^ set(seen.classes))
        raise ValueError(
            f"train/ and test/ under {cfg.root!r} must hold the same class folders; these "
            f"differ: {odd[:5]}."
        )
    classes = _label(known, cfg) | _label(seen, cfg)
    train, val = split(held(known, cfg), cfg)
    test = take(held(seen, cfg), cfg.test)
    return Splits(train, val, test, classes, _count(classes, cfg), _fingerprint(known))


def _fingerprint(pictures: ImageFolder) -> str:
    """Return sixteen hex digits that change with any name of a file."""
    sums = hashlib.sha256()
    for path, _ in pictures.samples:
        sums.update(Path(path).relative_to(pictures.root).as_posix().encode() + b"\0")
    return sums.hexdigest()[:16]


class Photos(ImageFolder):
    """A folder of classes, read upright; hidden files and folders, which file managers and
    notebooks leave behind, are no part of it."""

    def __init__(self, root: Path, transform: Callable) -> None:
        def is_picture(path: str) -> bool:
            return path.lower().endswith(SUFFIXES) and not _hidden(Path(path).relative_to(root))

        super().__init__(root, transform, loader=read_picture, is_valid_file=is_picture)

    def find_classes(self, directory: str | Path) -> tuple[list[str], dict[str, int]]:
        """Return the names of the class folders, and the number of each."""
        folders = (path for path in Path(directory).iterdir() if path.is_dir())
        names = sorted(path.name for path in folders if not _hidden(Path(path.name)))
        if not names:
            raise FileNotFoundError(f"there are no class folders in {directory}")
        return names, {name: number for number, name in enumerate(names)}


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _pictures(root: Path, cfg: Data) -> ImageFolder:
    try:
        return Photos(root, _resize(cfg.size))
    except (FileNotFoundError, RuntimeError) as error:
        raise ValueError(
            f"data.root={cfg.root!r} does not look like an image folder: {error}. "
            "It must hold train/<class>/ and test/<class>/, or <class>/ alone for a re-attack, "
            "with images inside."
        ) from error


def _label(pictures: ImageFolder, cfg: Data) -> dict[int, str]:
    """Have a folder's pictures labelled by `_numbers`; return the names of its classes."""
    numbers = _numbers(pictures.classes, cfg)
    labels = [numbers[name] for name in pictures.classes]
    pictures.target_transform = labels.__getitem__
    return {number: name for name, number in numbers.items()}


def _count(classes: dict[int, str], cfg: Data) -> int:
    """Return the number of logits."""
    return IMAGENET if cfg.class_index else len(classes)


def _numbers(names: list[str], cfg: Data) -> dict[str, int]:
    """Return the class of each folder: its place in the order, or what the CSV says."""
    if not cfg.class_index:
        return {name: i for i, name in enumerate(names)}
    known = _class_index(Path(cfg.class_index))
    lost = [n for n in names if not 0 <= known.get(n, IMAGENET) < IMAGENET]
    if lost:
        raise ValueError(
            f"{cfg.class_index} names no class_index from 0 to {IMAGENET - 1} for the folders "
            f"{lost[:5]} of {cfg.root!r}: add them."
        )
    found: dict[int, str] = {}
    for name in names:
        first = found.setdefault(known[name], name)
        if first != name:
            raise ValueError(
                f"{cfg.class_index} gives the folders {first!r} and {name!r} of {cfg.root!r} one "
                f"class_index, {known[name]}: give each its own, or make them one folder."
            )
    return {name: known[name] for name in names}


def _class_index(path: Path) -> dict[str, int]:
    """Return folder name to class index, from a CSV with the columns folder (or wnid) and
    class_index."""
    found: dict[str, int] = {}
    try:
        for row in read_table(path):
            name, number = row.get("folder") or row["wnid"], int(row["class_index"])
            if found.setdefault(name, number) != number:
                raise ValueError(f"{name} has two, {found[name]} and {number}")
        return found
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise ValueError(
            f"data.class_index={str(path)!r} could not be read ({error!r}). It must be a CSV file "
            "with a header and the columns folder (or wnid) and class_index, one row per folder."
        ) from error
