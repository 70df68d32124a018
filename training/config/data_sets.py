"""The data sets by name, a row each: their settings, and what reads them. A new one is a row, and a
function that reads it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING

from training.config.settings import setting

DEFAULT_DATA = "signs"
AUGMENTATIONS = ("none", "shift", "shift_flip", "crop_flip", "affine")
MAX_SEED = 2**32 - 1


@dataclass(frozen=True)
class DataSet:
    """A data set.

    Args:
        reader: "module:function" of `Data` that returns an `ImageSet`, or `Splits`; it is imported
            when it is needed.
        arguments: further arguments of that function.
        settings: its defaults of `Data`, where they are others.
        uses: the settings of `Data` that it uses and not every data set does.
        epochs: its default of train.epochs; None for that of `Train`.
        unlabelled_reader: as `reader`, for train.target=answers; "" for the same.
    """

    reader: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    uses: tuple[str, ...] = ()
    epochs: int | None = None
    unlabelled_reader: str = ""


def torchvision_set(
    name: str,
    train: Mapping[str, Any],
    test: Mapping[str, Any],
    augment: str,
    num_classes: int = 0,
) -> DataSet:
    """Return a data set that torchvision reads.

    Args:
        name: that of its class in `torchvision.datasets`.
        train, test: arguments of the parts to train and to test on.
        augment: default augmentation, one of `AUGMENTATIONS`.
        num_classes: number of its classes where torchvision has no names of them.
    """
    return DataSet(
        "training.data.image_sets:read_from_torchvision",
        {"class_name": name, "train": train, "test": test, "num_classes": num_classes},
        {"root": "data", "augment": augment},
        uses=("root", "download"),
    )


DATA_SETS = {
    DEFAULT_DATA: DataSet(
        "training.data.signs:read",
        settings={"size": 48, "train": 12000, "val": 320, "test": 1600},
        uses=("seed",),
        epochs=5,
    ),
    "cifar10": torchvision_set("CIFAR10", {"train": True}, {"train": False}, "shift_flip"),
    "cifar100": torchvision_set("CIFAR100", {"train": True}, {"train": False}, "shift_flip"),
    "gtsrb": torchvision_set("GTSRB", {"split": "train"}, {"split": "test"}, "affine", 43),
    "folder": DataSet(
        "training.data.image_sets:read",
        settings={"augment": "shift"},
        uses=("root", "class_index"),
        unlabelled_reader="training.data.image_sets:read_unlabelled",
    ),
}


def data_sets_with(setting: str) -> tuple[str, ...]:
    """Return the data sets that use a setting which not every data set does."""
    return tuple(name for name, one in DATA_SETS.items() if setting in one.uses)


def is_published(name: Any) -> bool:
    """Return whether the data set of a name can be fetched, and is the same in any folder."""
    return name in data_sets_with("download")


def is_users_own(name: Any) -> bool:
    """Return whether the data set of a name holds what the user has put into data.root."""
    return name in data_sets_with("root") and not is_published(name)


@dataclass
class Data:
    """The images, their size and their numbers."""

    name: str = setting(MISSING, "data set, by default signs", choices=tuple(DATA_SETS))
    root: str | None = setting(
        None,
        "folder of the data; for data=folder, with train/ and test/, or test classes alone; with "
        "train.target=answers, any pictures",
        is_path=True,
        only_for=data_sets_with("root"),
        may_differ=True,
    )
    size: int = setting(64, "side of the images, in pixels", bounds=(16, 8192))
    train: int | None = setting(
        None,
        "training images; null: all; with train.target=answers, fewer are repeated",
        bounds=(1, None),
    )
    val: int | None = setting(
        None, "validation images; null: 10 % of the training images", bounds=(1, None)
    )
    test: int | None = setting(None, "test images; null: all", bounds=(1, None), tests=True)
    seed: int = setting(
        0, "of the drawn images", bounds=(0, MAX_SEED), only_for=data_sets_with("seed")
    )
    class_index: str | None = setting(
        None,
        "CSV of folder (or wnid) and class_index of published weights",
        is_path=True,
        only_for=data_sets_with("class_index"),
    )
    augment: str = setting(
        "none",
        "none, shift (12.5 %), shift_flip, crop_flip, or affine (place, form, tone, erased parts)",
        choices=AUGMENTATIONS,
        trains=True,
    )
    workers: int = setting(
        0, "processes that read images", bounds=(0, 1024), changes_result=False, trains=True
    )
    download: bool = setting(
        False,
        "fetch a published data set",
        changes_result=False,
        only_for=data_sets_with("download"),
    )


DATA = {name: Data(name=name, **one.settings) for name, one in DATA_SETS.items()}
EPOCHS_HELP = ", ".join(f"{one.epochs} for {name}" for name, one in DATA_SETS.items() if one.epochs)
