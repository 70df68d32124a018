"""Seeds for albumentations transforms in a DataLoader's workers."""

from __future__ import annotations

from functools import partial
from types import ModuleType
from typing import Any

import torch
from albumentations.core.composition import BaseCompose
from albumentations.core.transforms_interface import BasicTransform

MOST = 1000  # parts of a list; a longer one holds samples
STRIDE = 0x9E3779B1  # odd, so that seeds of different places and workers differ


def seed_worker(worker_id: int) -> None:
    """Seed the albumentations transforms of a DataLoader's data set, for
    `DataLoader(..., worker_init_fn=seed_worker)`.

    Without it workers repeat each other's draws, and with `Compose(seed=)` every epoch repeats the
    first. The seeds follow torch's: distinct per worker, epoch and transform, the same after
    `torch.manual_seed`.

    Raises:
        ValueError: no transform is found among the data set's attributes, nor in the lists, dicts,
            partial functions and objects that these hold.
        RuntimeError: it is called outside a worker.
    """
    worker = torch.utils.data.get_worker_info()
    if worker is None:
        raise RuntimeError(
            "seed_worker is for the workers of a DataLoader: pass it as "
            "DataLoader(worker_init_fn=...)."
        )
    dataset = worker.dataset
    found = transforms_of(dataset)
    if not found:
        raise ValueError(
            "seed_worker found no albumentations transform among the attributes of "
            f"{type(dataset).__name__}. Keep the Compose as one, or call its "
            "set_random_seed(torch.initial_seed() % 2**32) in a worker_init_fn of your own."
        )
    for place, transform in enumerate(found):
        # two views of one image must not be the same
        transform.set_random_seed((torch.initial_seed() + place * STRIDE) % 2**32)


def transforms_of(dataset: torch.utils.data.Dataset) -> list[BaseCompose | BasicTransform]:
    """Return the transforms among a data set's attributes, and in the lists, dicts, partial
    functions and objects that these hold; each of them once, always in the same order."""
    found: list[BaseCompose | BasicTransform] = []
    owners: list[Any] = [dataset]
    seen = {id(dataset)}
    for owner in owners:  # which grows
        for part in _parts_of(owner):
            if id(part) in seen:
                continue
            seen.add(id(part))
            if isinstance(part, (BaseCompose, BasicTransform)):
                found.append(part)
            else:
                owners.append(part)
    return found


def _parts_of(owner: Any) -> list[Any]:
    """Return what an object holds that may be or hold a transform."""
    if isinstance(owner, (list, tuple, dict)):
        parts = list(owner.values()) if isinstance(owner, dict) else list(owner)
        return parts if len(parts) <= MOST else []
    if isinstance(owner, (type, ModuleType, torch.nn.Module)):
        return []
    parts = list(getattr(owner, "__dict__", {}).values())
    if isinstance(owner, partial):
        parts += [owner.func, owner.args, owner.keywords]
    for kind in type(owner).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            parts.append(getattr(owner, name, None))
    return parts
