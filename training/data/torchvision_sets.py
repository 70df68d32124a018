"""Data sets that torchvision reads and downloads."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchvision import datasets

from training.config.schema import Data
from training.data.image_sets import resize
from training.data.splits import ImageSet
from training.system.files import locked


def read(
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
    options = {"transform": resize(cfg.size), "download": cfg.download}
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
    return ImageSet(train_set, test_set, dict(enumerate(map(str, names))), len(names))


def _download_lock(cfg: Data) -> contextlib.AbstractContextManager[None]:
    """Let one process at a time download into a folder; the others find the data set there."""
    if not cfg.download:
        return contextlib.nullcontext()
    os.makedirs(cfg.root or "", exist_ok=True)
    return locked(Path(cfg.root or "", ".download.lock"), "", wait_seconds=-1)
