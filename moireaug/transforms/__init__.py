"""Transforms for torchvision, kornia and albumentations. They hold no physics, and none imports
another's library.

`RandomMoire` is torchvision's; `kornia.RandomMoire` and `albumentations.RandomMoire` share its
arguments `scene` and `p`.
"""

from __future__ import annotations

import importlib
from typing import Any

DOORS = ("torchvision", "kornia", "albumentations")
HOMES = {"RandomMoire": "torchvision", "AdversarialMoire": "adversarial"}

__all__ = ["AdversarialMoire", "RandomMoire", "albumentations", "kornia", "torchvision"]


def __getattr__(name: str) -> Any:
    if name in DOORS:
        return importlib.import_module(f".{name}", __name__)
    if name in HOMES:
        return getattr(importlib.import_module(f".{HOMES[name]}", __name__), name)
    raise AttributeError(
        f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}."
    )


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
