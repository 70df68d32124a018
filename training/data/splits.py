"""Three parts of a data set, to train, validate and test on."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.data import Dataset, Subset

from training.config.schema import Data

HELD_BYTES = 1 << 30  # of decoded images that are kept


class Splits(NamedTuple):
    """Three data sets of (uint8 image, label), the classes' names, and the number of classes of a
    model for them.

    Args:
        files: fingerprint of the files that are trained and validated on; empty where the settings
            say which images these are.
    """

    train: Dataset
    val: Dataset
    test: Dataset
    classes: dict[int, str]
    num_classes: int
    files: str = ""


def has_parts(root: str | Path) -> bool:
    """Return whether a folder of images is split into train/ and test/: either alone may be the
    name of a class."""
    return all((Path(root) / part).is_dir() for part in ("train", "test"))


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


def held(data: Dataset, cfg: Data) -> Dataset:
    """Keep a data set in memory if it is small and no workers, which share no memory, read it."""
    size = len(data) * 3 * cfg.size**2  # type: ignore[arg-type]
    return data if cfg.workers or size > HELD_BYTES else Held(data)


def shuffled(n: int, seed: int) -> list[int]:
    """Return the numbers below n in a random order, the same for a seed."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randperm(n, generator=generator, device="cpu").tolist()


def take(data: Dataset, n: int | None, seed: int = 0) -> Dataset:
    """Return a fixed random subset of n items; all of them if n is None or not smaller."""
    if n is None or n >= len(data):  # type: ignore[arg-type]
        return data
    return Subset(data, shuffled(len(data), seed)[:n])  # type: ignore[arg-type]


def split(data: Dataset, cfg: Data) -> tuple[Dataset, Dataset]:
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
    order = shuffled(total, 0)
    return take(Subset(data, order[held:]), cfg.train), Subset(data, order[:held])
