"""Synthesis: pictures, their photos off a screen, and the same photos without moiré, aligned."""

from __future__ import annotations

import importlib
from typing import Any

MODULE_OF_CLASS = {"Pair": "pairs", "Pairs": "pairs", "without_moire": "twins"}

__all__ = ["Pair", "Pairs", "without_moire"]


def __getattr__(name: str) -> Any:
    if name in MODULE_OF_CLASS:
        return getattr(importlib.import_module(f".{MODULE_OF_CLASS[name]}", __name__), name)
    raise AttributeError(
        f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}."
    )


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
