"""Data sets by name: uint8 images (3, size, size) and labels, split into train, val and test."""

import pkgutil

from training.config.data_sets import DATA_SETS, Data
from training.data.splits import Splits, repeated, split


def load(cfg: Data, target: str = "labels") -> Splits:
    """Load a data set by its name, `cfg.name`.

    Args:
        target: `train.target`; "answers" needs no labels, and takes a folder of any pictures.
    """
    data_set = DATA_SETS[cfg.name]
    is_unlabelled = target == "answers" and bool(data_set.unlabelled_reader)
    name = data_set.unlabelled_reader if is_unlabelled else data_set.reader
    images = pkgutil.resolve_name(name)(cfg, **data_set.arguments)
    splits = images if isinstance(images, Splits) else split(images, cfg)
    if is_unlabelled:
        return splits._replace(train=repeated(splits.train, cfg.train))
    return splits
