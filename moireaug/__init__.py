"""moireaug: physical, differentiable moiré for vision models."""

import importlib
from typing import Any

from moireaug.capture import capture, develop, expose
from moireaug.effects.panel import Layout
from moireaug.parts import Develop, Lens, Panel, Sensor, View
from moireaug.plan import Plan
from moireaug.scene import Scene
from moireaug.shot import Shot

__all__ = [
    "Develop",
    "Layout",
    "Lens",
    "Panel",
    "Plan",
    "Scene",
    "Sensor",
    "Shot",
    "View",
    "capture",
    "develop",
    "expose",
]

LAZY = ("attacks", "defenses", "evaluation", "transforms")  # packages that are imported when first asked for


def __getattr__(name: str) -> Any:
    if name in LAZY:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}.")
