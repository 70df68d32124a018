"""Data sets by name: uint8 images (3, size, size) and labels, split into train, val and test."""

import functools

from torch import Tensor
from torch.utils.data import Dataset

from training.config.schema import DATA, Data
from training.data import signs
from training.data.splits import Splits, repeated, split


def load(cfg: Data, target: str = "labels") -> Splits:
    """Load a data set by its name, `cfg.name`.

    Args:
        target: `train.target`; "answers" needs no labels, and takes a folder of any pictures.
    """
    if cfg.name == "signs":
        return _load_signs(cfg)
    from training.data import image_sets

    if cfg.name == "folder" and target == "answers":
        splits = split(image_sets.read_unlabelled(cfg), cfg)
        return splits._replace(train=repeated(splits.train, cfg.train))
    return split(image_sets.read(cfg), cfg)


class Signs(Dataset):
    """One split of the signs, all of it drawn once the first image is read: an attack on trained
    weights needs no training images.

    Args: as in `signs.make`.
    """

    def __init__(self, split: str, n: int, size: int, seed: int) -> None:
        self.split, self.n, self.size, self.seed = split, n, size, seed

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        images, labels = self._images_and_labels
        return images[index], labels[index]

    @functools.cached_property
    def _images_and_labels(self) -> tuple[Tensor, Tensor]:
        return signs.make(self.split, self.n, self.size, self.seed)


def _load_signs(cfg: Data) -> Splits:
    parts = {}
    for part in signs.SPLITS:
        n = getattr(cfg, part)
        if n is None:
            n = getattr(DATA["signs"], part)
        parts[part] = Signs(part, n, cfg.size, cfg.seed)
    classes = dict(enumerate(signs.CLASSES))
    return Splits(parts["train"], parts["val"], parts["test"], classes, len(classes))
