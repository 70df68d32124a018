"""Seeds for albumentations transforms in a DataLoader's workers."""

from __future__ import annotations

import sys
import sysconfig
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import FunctionType, MappingProxyType, MemberDescriptorType, MethodType, ModuleType
from typing import Any

import numpy as np
import torch
from albumentations.core.composition import BaseCompose
from albumentations.core.transforms_interface import BasicTransform

from moireaug.callables import enclosed_values, names_in

MAX_COLLECTION_LENGTH = 1000  # of a list or dict; a longer one holds samples
SEED_STRIDE = 0x9E3779B1  # odd, so that seeds of different transforms and workers differ
VALUES = (str, bytes, int, float, type(None), np.ndarray, np.generic, torch.Tensor)
OWN_PACKAGE = __name__.partition(".")[0]


def seed_worker(worker_id: int) -> None:
    """Seed the albumentations transforms of a DataLoader's data set, for
    `DataLoader(..., worker_init_fn=seed_worker)`.

    Without it workers repeat each other's draws, and with `Compose(seed=)` every epoch repeats the
    first. The seeds follow torch's: distinct per worker, epoch and transform, the same after
    `torch.manual_seed`.

    A transform is found wherever the data set leads to it:

    - in an attribute or slot of an object, `nn.Module`s and other data sets included, or of a class
      of your modules;
    - in a list, tuple, deque or dict of at most 1,000 entries;
    - in a function, lambda, method or `functools.partial`: its defaults, its closure, the object
      that it is bound to, and the globals of your modules that its code names.

    It is not found where nothing leads to it: one that is made or imported within a function, or is
    held by a `collate_fn`, a set, an `A.Lambda`, a function or an iterator written in C, or a class
    or global of an installed package. Seed such a transform in a `worker_init_fn` of your own.

    Raises:
        ValueError: no transform is found.
        RuntimeError: it is called outside a worker.
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
    """Return the transforms that a data set leads to, as `seed_worker` lists the ways, each of them
    once, always in the same order."""
    transforms: list[BaseCompose | BasicTransform] = []
    owners: list[Any] = [dataset]
    visited = {id(dataset)}
    for owner in owners:  # which grows
        for part in _parts_of(owner):
            if id(part) in visited or isinstance(part, VALUES):
                continue
            visited.add(id(part))
            if isinstance(part, (BaseCompose, BasicTransform)):
                transforms.append(part)
            else:
                owners.append(part)
    return transforms


def _parts_of(owner: Any) -> list[Any]:
    """Return what an object holds that may be or hold a transform."""
    parts: list[Any] = []
    for kinds, parts_of_kind in PARTS:
        if isinstance(owner, kinds):
            parts += parts_of_kind(owner)
    return parts


def _entries_of(collection: Any) -> Iterable[Any]:
    if len(collection) > MAX_COLLECTION_LENGTH:
        return ()
    return collection.values() if isinstance(collection, Mapping) else collection


def _function_parts_of(function: FunctionType) -> list[Any]:
    defaults = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    return [*defaults, *enclosed_values(function), *_globals_of(function)]


def _globals_of(function: FunctionType) -> list[Any]:
    """Return the globals that a function's code names, in its own module and in the modules that it
    names, without those of libraries."""
    names = names_in(function.__code__)
    namespaces, values = [function.__globals__], []
    for namespace in namespaces:  # which grows
        if _is_of_library(namespace):
            continue
        for name in sorted(names & namespace.keys()):
            value = namespace[name]
            if not isinstance(value, ModuleType):
                values.append(value)
            elif all(vars(value) is not known for known in namespaces):
                namespaces.append(vars(value))
    return values


def _class_parts_of(kind: type) -> list[Any]:
    """Return the attributes and methods of a class, and its bases; nothing for a library's."""
    module = sys.modules.get(kind.__module__)
    if module is not None and _is_of_library(vars(module)):
        return []
    return [*vars(kind).values(), *kind.__bases__]


def _attributes_of(owner: Any) -> list[Any]:
    """Return an object's attributes, its slots among them, and its class."""
    attributes = list(getattr(owner, "__dict__", {}).values())
    for kind in type(owner).__mro__:
        if "__slots__" not in vars(kind):
            continue
        for slot in vars(kind).values():
            if isinstance(slot, MemberDescriptorType):
                with suppress(AttributeError):  # a slot that is still empty
                    attributes.append(slot.__get__(owner))
    return [*attributes, type(owner)]


def _is_of_library(namespace: dict[str, Any]) -> bool:
    """Return whether a module's globals belong to Python, this package or an installed one: they
    hold no transform of the user's, and lead everywhere."""
    name, file = str(namespace.get("__name__")), namespace.get("__file__")
    if name.partition(".")[0] == OWN_PACKAGE or name in sys.builtin_module_names:
        return True
    if not file:  # a notebook
        return False
    path = Path(file)
    installed = {"site-packages", "dist-packages"} & {*path.parts}
    return bool(installed) or path.is_relative_to(sysconfig.get_path("stdlib"))


# what is walked of an object of each kind; of one of several kinds, all of it
PARTS: tuple[tuple[type | tuple[type, ...], Callable[[Any], Iterable[Any]]], ...] = (
    ((list, tuple, deque, dict, MappingProxyType), _entries_of),
    (partial, lambda call: (call.func, call.args, call.keywords)),
    (MethodType, lambda method: (method.__self__, method.__func__)),
    ((staticmethod, classmethod), lambda method: (method.__func__,)),
    (property, lambda method: (method.fget,)),
    (FunctionType, _function_parts_of),
    (type, _class_parts_of),
    (object, lambda owner: () if isinstance(owner, (type, ModuleType)) else _attributes_of(owner)),
)
