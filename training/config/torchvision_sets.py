"""The data sets that torchvision reads, a row each: a new one needs nothing else."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class TorchvisionSet:
    """A data set of torchvision.

    Args:
        reader: name of its class in `torchvision.datasets`, whose import takes seconds.
        train, test: arguments of the parts to train and to test on.
        augment: default augmentation, one of `AUGMENTATIONS`.
        num_classes: number of its classes where the reader has no names of them.
    """

    reader: str
    train: Mapping[str, Any]
    test: Mapping[str, Any]
    augment: str
    num_classes: int = 0


TORCHVISION_SETS = {
    "cifar10": TorchvisionSet("CIFAR10", {"train": True}, {"train": False}, "shift_flip"),
    "cifar100": TorchvisionSet("CIFAR100", {"train": True}, {"train": False}, "shift_flip"),
    "gtsrb": TorchvisionSet("GTSRB", {"split": "train"}, {"split": "test"}, "affine", 43),
}
