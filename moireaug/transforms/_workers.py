"""Seeds for albumentations transforms in a DataLoader's workers."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from albumentations.core.composition import BaseCompose
from albumentations.core.transforms_interface import BasicTransform


def seed_worker(worker_id: int) -> None:
    """Seed the albumentations transforms of a DataLoader's data set, for
    `DataLoader(..., worker_init_fn=seed_worker)`.

    Without it workers repeat each other's draws, and with `Compose(seed=)` every epoch repeats the
    first. The seeds follow torch's: distinct per worker and epoch, the same after
    `torch.manual_seed`.

    Raises:
        ValueError: no transform is found among the data set's attributes, nor those of the data
            sets that it wraps.
        RuntimeError: it is called outside a worker.
    """
    worker = torch.utils.data.get_worker_info()
    if worker is None:
        raise RuntimeError(
            "seed_worker is for the workers of a DataLoader: pass it as "
            "DataLoader(worker_init_fn=...)."
        )
    dataset = worker.dataset
    found = list(_transforms_of(dataset))
    if not found:
        raise ValueError(
            "seed_worker found no albumentations transform among the attributes of "
            f"{type(dataset).__name__}. Keep the Compose as one, or call its "
            "set_random_seed(torch.initial_seed() % 2**32) in a worker_init_fn of your own."
        )
    for transform in found:
        transform.set_random_seed(torch.initial_seed() % 2**32)


def _transforms_of(owner: torch.utils.data.Dataset) -> Iterator[BaseCompose | BasicTransform]:
    for attribute in vars(owner).values():
        # a list of samples holds no transform
        short = isinstance(attribute, (list, tuple)) and len(attribute) <= 1000
        for value in attribute if short else [attribute]:
            if isinstance(value, (BaseCompose, BasicTransform)):
                yield value
            elif isinstance(value, torch.utils.data.Dataset):
                yield from _transforms_of(value)
