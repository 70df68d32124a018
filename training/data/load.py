"""Data sets by name: uint8 images (3, size, size) and labels, split into train, val and test."""

from __future__ import annotations

import functools
from pathlib import Path

from torch import Tensor
from torch.utils.data import Dataset

from moireaug.scene.fields import one_of
from training.config.data_sets import AUGMENTATIONS, DATA, Data
from training.config.settings import settings_of
from training.data import signs
from training.data.splits import Splits, has_parts


def load(cfg: Data) -> Splits:
    """Load a data set by its name, `cfg.name`.

    Raises:
        ValueError: an unknown name or augmentation, a missing folder, folders that do not fit; says
            what to do.
    """
    one_of("data.augment", cfg.augment, AUGMENTATIONS)
    if one_of("data", cfg.name, DATA) == "signs":
        return _load_signs(cfg)
    from training.data import image_sets

    return image_sets.load_folder(cfg) if cfg.name == "folder" else image_sets.load_published(cfg)


def require_used(cfg: Data) -> None:
    """Refuse settings that the data set would not use.

    Raises:
        ValueError: with what to do.
    """
    for key, one in settings_of(Data).items():
        value = getattr(cfg, key)
        is_used = not one.facts.only_for or cfg.name in one.facts.only_for
        if not is_used and value != getattr(DATA[cfg.name], key):
            raise ValueError(
                f"data.{key}={value} has no effect on data={cfg.name}: leave it out, or name "
                "the data set that it is for, such as data=folder."
            )


def require_training_images(cfg: Data) -> None:
    """Refuse a folder of class folders alone, whose images are all for testing.

    Raises:
        ValueError: with what to do.
    """
    if cfg.name != "folder" or not cfg.root or not Path(cfg.root).is_dir():
        return
    if not has_parts(cfg.root):
        raise ValueError(
            f"data.root={cfg.root!r} lacks train/ or test/, so that all its images are for "
            "testing. Training needs train/<class>/ and test/<class>/ in it; to attack given "
            "weights on these images, use training/reattack.py."
        )


class Signs(Dataset):
    """One split of the signs, all of it drawn once the first image is read: an attack on trained
    weights needs no training images.

    Args: as in `signs.make`.
    """

    def __init__(self, split: str, n: int, size: int) -> None:
        self.split, self.n, self.size = split, n, size

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        images, labels = self._images_and_labels
        return images[index], labels[index]

    @functools.cached_property
    def _images_and_labels(self) -> tuple[Tensor, Tensor]:
        return signs.make(self.split, self.n, self.size)


def _load_signs(cfg: Data) -> Splits:
    parts = {}
    for split in signs.SPLITS:
        n = getattr(cfg, split)
        if n is None:
            n = getattr(DATA["signs"], split)
        parts[split] = Signs(split, n, cfg.size)
    classes = dict(enumerate(signs.CLASSES))
    return Splits(parts["train"], parts["val"], parts["test"], classes, len(classes))
