"""The data sets by name, a row each: their settings, and what reads them. A new one is a row, and a
function that reads it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

DEFAULT_DATA = "signs"


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


def users_of(setting: str) -> tuple[str, ...]:
    """Return the data sets that use one of the settings that not every data set does."""
    return tuple(name for name, one in DATA_SETS.items() if setting in one.uses)


def is_published(name: Any) -> bool:
    """Return whether the data set of a name can be fetched, and is the same in any folder."""
    return name in users_of("download")


def is_users_own(name: Any) -> bool:
    """Return whether the data set of a name holds what the user has put into data.root."""
    return name in users_of("root") and not is_published(name)
