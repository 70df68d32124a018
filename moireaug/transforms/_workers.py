"""Seeds for albumentations transforms in a DataLoader's workers."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import torch
from albumentations.core.composition import BaseCompose
from albumentations.core.transforms_interface import BasicTransform

from moireaug.common.networks import reachable

SEED_STRIDE = 0x9E3779B1  # odd, so that seeds of different transforms and workers differ
DATA_TYPES = (str, bytes, int, float, type(None), np.ndarray, np.generic, torch.Tensor)
TRANSFORM_TYPES = (BaseCompose, BasicTransform)


def seed_worker(worker_id: int) -> None:
    """Seed the albumentations transforms of a DataLoader's data set, for
    `DataLoader(..., worker_init_fn=seed_worker)`.

    Without it workers repeat each other's draws, and with `Compose(seed=)` every epoch repeats the
    first. The seeds follow torch's: distinct per worker, epoch and transform, the same after
    `torch.manual_seed`.

    A transform is found where the data set leads to it: by attributes, lists, tuples and dicts of
    at most 1,000 entries, bound methods, partial functions, and the closures, defaults and globals
    of functions. It is not found in a slot, a class, a set or a `collate_fn`, nor where a function
    makes it or calls another one by its name: seed such a one in a `worker_init_fn` of your own.

    Raises:
        ValueError, RuntimeError: no transform is found, or it is called outside a worker.
    """
    worker = torch.utils.data.get_worker_info()
    if worker is None:
        raise RuntimeError(
            "seed_worker is for the workers of a DataLoader: pass it as "
            "DataLoader(worker_init_fn=...)."
        )
    transforms = transforms_of(worker.dataset)
    if not transforms:
        raise ValueError(
            "seed_worker found no albumentations transform that "
            f"{type(worker.dataset).__name__} leads to. Keep the Compose as an attribute of the "
            "data set, or call its set_random_seed(torch.initial_seed() % 2**32) in a "
            "worker_init_fn of your own."
        )
    for place, transform in enumerate(transforms):
        # two views of one image must not be the same
        transform.set_random_seed((torch.initial_seed() + place * SEED_STRIDE) % 2**32)


def transforms_of(dataset: torch.utils.data.Dataset) -> list[BaseCompose | BasicTransform]:
    """Return the transforms that a data set leads to, see `reachable`, each once, always in the
    same order."""
    found = []
    for part in reachable(dataset, lambda p: not isinstance(p, (*DATA_TYPES, *TRANSFORM_TYPES))):
        with suppress(Exception):  # of proxies
            if isinstance(part, TRANSFORM_TYPES):
                found.append(part)
    return found
