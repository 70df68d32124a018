"""Folders of images and torchvision's data sets, as uint8 images (3, size, size)."""

import contextlib
import csv
import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torch.utils.data import Subset
from torchvision import datasets
from torchvision.datasets import ImageFolder
from torchvision.transforms import v2

from moireaug.common.image_files import read_picture
from moireaug.synthesis.pictures import SUFFIXES, files_below
from training.config.data_sets import Data
from training.data.splits import ImageSet, shuffled_indices
from training.system.files import has_parts, locked, read_table

MIN_UNLABELLED = 3  # pictures of a folder without labels
IMAGENET_CLASSES = 1000  # of torchvision's published weights, which a class_index refers to


def _resize(size: int) -> v2.Compose:
    """Resize the shorter side to `size` and cut out the centre: as ImageNet models are
    evaluated, without the margin of the usual 256 px."""
    return v2.Compose([v2.Resize(size, antialias=True), v2.CenterCrop(size), v2.PILToTensor()])


def read_from_torchvision(
    cfg: Data,
    class_name: str,
    train: Mapping[str, Any],
    test: Mapping[str, Any],
    num_classes: int,
) -> ImageSet:
    """Read a data set, and download it first where that is asked for; arguments as in
    `torchvision_set`."""
    if not cfg.root:
        raise ValueError(
            f"data={cfg.name} needs data.root=DIR, the folder where torchvision has put the "
            "data set, or puts it with data.download=true."
        )
    make = getattr(datasets, class_name)
    transform = v2.Compose([v2.RGB(), _resize(cfg.size)])  # some sets are grey
    options = {"transform": transform, "download": cfg.download}
    try:
        with _download_lock(cfg):
            train_set = make(cfg.root, **train, **options)
            test_set = make(cfg.root, **test, **options)
    except (RuntimeError, OSError) as error:
        if cfg.download:
            raise ValueError(
                f"The data set {cfg.name!r} could not be fetched into data.root={cfg.root!r} "
                f"({error}). Check the network, or pass as data.root a folder that has it."
            ) from error
        raise ValueError(
            f"The data set {cfg.name!r} was not found under data.root={cfg.root!r} ({error}). "
            "Pass data.download=true to fetch it, or as data.root the folder where torchvision "
            "has put it."
        ) from error
    names = getattr(test_set, "classes", None) or range(num_classes)
    if not names:
        raise ValueError(
            f"torchvision names no classes of {class_name}: give their number, num_classes, in the "
            f"row {cfg.name!r} of DATA_SETS."
        )
    return ImageSet(train_set, test_set, dict(enumerate(map(str, names))), len(names))


def _download_lock(cfg: Data) -> contextlib.AbstractContextManager[None]:
    """Let one process at a time download into a folder; the others find the data set there."""
    if not cfg.download:
        return contextlib.nullcontext()
    os.makedirs(cfg.root or "", exist_ok=True)
    return locked(Path(cfg.root or "", ".download.lock"), "", wait_seconds=-1)


def read_unlabelled(cfg: Data) -> ImageSet:
    """Read all pictures in a folder and below as one class: those of train/ and test/, or of other
    folders a tenth to test on."""
    root = _root(cfg, "pictures")
    if has_parts(root):
        train, test = (_read_pictures(root / part, cfg, OneClass) for part in ("train", "test"))
        return ImageSet(train, test, {0: "pictures"}, 1, _fingerprint(train))
    pictures = _read_pictures(root, cfg, OneClass)
    total = len(pictures)
    if total < MIN_UNLABELLED:
        raise ValueError(
            f"data.root={cfg.root!r} holds {total} pictures, of which some train, some validate "
            f"and some test: it must hold at least {MIN_UNLABELLED}, and better thousands."
        )
    order, test_count = shuffled_indices(total, 0), max(1, total // 10)
    return ImageSet(
        Subset(pictures, order[test_count:]),
        Subset(pictures, order[:test_count]),
        {0: "pictures"},
        1,
        _fingerprint(pictures),
    )


def _root(cfg: Data, content: str) -> Path:
    """Return the folder of data=folder, refused where there is none."""
    if not cfg.root:
        raise ValueError(f"data=folder needs data.root=DIR, a folder with {content} inside it.")
    root = Path(cfg.root)
    if not root.is_dir():
        raise ValueError(
            f"data.root={cfg.root!r} is not a folder. Pass data.root=DIR with {content} inside it."
        )
    return root


def read(cfg: Data) -> ImageSet:
    """Read a folder with train/ and test/, or one of class folders alone: all are test images."""
    root = _root(cfg, "train/ and test/")
    if not has_parts(root):  # class folders alone: all of it is test data
        pictures = _read_pictures(root, cfg)
        classes = _label_pictures(pictures, cfg)
        return ImageSet(None, pictures, classes, _num_classes(classes, cfg))
    train_pictures = _read_pictures(root / "train", cfg)
    test_pictures = _read_pictures(root / "test", cfg)
    # with data.class_index, a class need not be in both
    if train_pictures.classes != test_pictures.classes and not cfg.class_index:
        differing = sorted(set(train_pictures.classes) ^ set(test_pictures.classes))
        raise ValueError(
            f"train/ and test/ under {cfg.root!r} must hold the same class folders; these "
            f"differ: {differing[:5]}."
        )
    classes = _label_pictures(train_pictures, cfg) | _label_pictures(test_pictures, cfg)
    num_classes, files = _num_classes(classes, cfg), _fingerprint(train_pictures)
    return ImageSet(train_pictures, test_pictures, classes, num_classes, files)


def _fingerprint(pictures: ImageFolder) -> str:
    """Return sixteen hex digits that change with any name of a file."""
    sums = hashlib.sha256()
    for path, _ in pictures.samples:
        name = Path(path).relative_to(pictures.root).as_posix()
        sums.update(name.encode("utf-8", "surrogateescape") + b"\0")
    return sums.hexdigest()[:16]


class UprightFolder(ImageFolder):
    """A folder of classes, read upright; hidden files and folders, which file managers and
    notebooks leave behind, are no part of it."""

    def __init__(self, root: Path, transform: Callable) -> None:
        super().__init__(root, transform, loader=read_picture)

    @staticmethod
    def make_dataset(
        directory: str | Path, class_to_idx: dict[str, int], *_: Any, **__: Any
    ) -> list[tuple[str, int]]:
        """Return each picture's path and the number of its class."""
        samples: list[tuple[str, int]] = []
        class_of: dict[Path, str] = {}
        for name, number in class_to_idx.items():
            folder = Path(directory, name)
            names = [file for file in files_below(folder) if file.lower().endswith(SUFFIXES)]
            if not names:
                raise FileNotFoundError(
                    f"{folder} holds no pictures ({', '.join(SUFFIXES)}): add some, or remove it"
                )
            paths = [folder / file for file in names]
            paths.sort(key=lambda path: (str(path.parent), path.name))
            for place in {path.parent for path in paths}:
                owner = class_of.setdefault(place.resolve(), name)
                if owner != name:
                    raise FileNotFoundError(
                        f"{place} is in two classes, {owner!r} and {name!r}, by a link: remove it"
                    )
            samples += [(str(path), number) for path in paths]
        return samples

    def find_classes(self, directory: str | Path) -> tuple[list[str], dict[str, int]]:
        """Return the names of the class folders, and the number of each."""
        folders = (path for path in Path(directory).iterdir() if path.is_dir())
        names = sorted(path.name for path in folders if not path.name.startswith("."))
        if not names:
            raise FileNotFoundError(f"there are no class folders in {directory}")
        return names, {name: number for number, name in enumerate(names)}


class OneClass(UprightFolder):
    """A folder of pictures of one class, whatever folders they are in."""

    def find_classes(self, directory: str | Path) -> tuple[list[str], dict[str, int]]:
        """Return one class, whose folder is this one."""
        return ["."], {".": 0}


def _read_pictures(
    root: Path, cfg: Data, kind: type[UprightFolder] = UprightFolder
) -> UprightFolder:
    try:
        return kind(root, _resize(cfg.size))
    except (FileNotFoundError, RuntimeError) as error:
        content = "train/<class>/ and test/<class>/, or <class>/ alone for a re-attack, with images"
        if kind is OneClass:
            content = "images, or train/ and test/ with images"
        raise ValueError(
            f"data.root={cfg.root!r} does not look like an image folder: {error}. "
            f"It must hold {content} inside."
        ) from error


def _label_pictures(pictures: ImageFolder, cfg: Data) -> dict[int, str]:
    """Have a folder's pictures labelled by `_class_numbers`; return the names of its classes."""
    numbers = _class_numbers(pictures.classes, cfg)
    labels = [numbers[name] for name in pictures.classes]
    pictures.target_transform = labels.__getitem__
    return {number: name for name, number in numbers.items()}


def _num_classes(classes: dict[int, str], cfg: Data) -> int:
    """Return the number of logits."""
    return IMAGENET_CLASSES if cfg.class_index else len(classes)


def _class_numbers(names: list[str], cfg: Data) -> dict[str, int]:
    """Return the class of each folder: its place in the order, or its class_index in the CSV."""
    if not cfg.class_index:
        return {name: i for i, name in enumerate(names)}
    class_index = _read_class_index(Path(cfg.class_index))
    published = range(IMAGENET_CLASSES)
    unnumbered = [name for name in names if class_index.get(name) not in published]
    if unnumbered:
        raise ValueError(
            f"{cfg.class_index} names no class_index from 0 to {IMAGENET_CLASSES - 1} for the "
            f"folders {unnumbered[:5]} of {cfg.root!r}: add them."
        )
    folder_of: dict[int, str] = {}
    for name in names:
        first = folder_of.setdefault(class_index[name], name)
        if first != name:
            raise ValueError(
                f"{cfg.class_index} gives the folders {first!r} and {name!r} of {cfg.root!r} one "
                f"class_index, {class_index[name]}: give each its own, or make them one folder."
            )
    return {name: class_index[name] for name in names}


def _read_class_index(path: Path) -> dict[str, int]:
    """Return folder name to class index, from a CSV with the columns folder (or wnid) and
    class_index."""
    class_index: dict[str, int] = {}
    try:
        for row in read_table(path):
            name, number = row.get("folder") or row["wnid"], int(row["class_index"])
            if class_index.setdefault(name, number) != number:
                raise ValueError(f"{name} has two, {class_index[name]} and {number}")
        return class_index
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise ValueError(
            f"data.class_index={str(path)!r} could not be read ({error!r}). It must be a CSV file "
            "with a header and the columns folder (or wnid) and class_index, one row per folder."
        ) from error
