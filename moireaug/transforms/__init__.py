"""Transforms for torchvision, kornia and albumentations. They hold no physics, and none imports
another's library.

`RandomMoire` is torchvision's; `kornia.RandomMoire` and `albumentations.RandomMoire` share its
arguments `scene` and `p`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # at run time on first use, as each imports its library
    from moireaug.transforms import albumentations, kornia, torchvision
    from moireaug.transforms.adversarial import AdversarialMoire
    from moireaug.transforms.torchvision import RandomMoire

MODULE_OF_CLASS = {"RandomMoire": "torchvision", "AdversarialMoire": "adversarial"}

__all__ = ["AdversarialMoire", "RandomMoire", "albumentations", "kornia", "torchvision"]


if not TYPE_CHECKING:  # which would hide that a name is unknown

    def __getattr__(name: str) -> Any:
        if name not in __all__:
            raise AttributeError(
                f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}."
            )
        module = importlib.import_module(f".{MODULE_OF_CLASS.get(name, name)}", __name__)
        return getattr(module, name) if name in MODULE_OF_CLASS else module


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
