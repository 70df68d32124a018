"""moireaug: physical, differentiable moiré for vision models."""

import importlib
from typing import TYPE_CHECKING, Any

from moireaug.capture import capture, develop, expose
from moireaug.scene.layout import Layout
from moireaug.scene.parts import Develop, Lens, Panel, Sensor, View
from moireaug.scene.plan import Plan
from moireaug.scene.track import Hand
from moireaug.scenes import Scene, Shot

if TYPE_CHECKING:  # at run time on first use
    from moireaug import attacks as attacks
    from moireaug import defenses as defenses
    from moireaug import evaluation as evaluation
    from moireaug import nn as nn
    from moireaug import synthesis as synthesis
    from moireaug import transforms as transforms

__version__ = "0.2.0.dev0"

__all__ = [
    "Develop",
    "Hand",
    "Layout",
    "Lens",
    "Panel",
    "Plan",
    "Scene",
    "Sensor",
    "Shot",
    "View",
    "__version__",
    "capture",
    "develop",
    "expose",
]

# subpackages imported on first use
LAZY = ("attacks", "defenses", "evaluation", "nn", "synthesis", "transforms")


if not TYPE_CHECKING:  # which would hide that a name is unknown

    def __getattr__(name: str) -> Any:
        if name in LAZY:
            return importlib.import_module(f".{name}", __name__)
        raise AttributeError(
            f"module {__name__!r} has no attribute {name!r}; it has {', '.join([*__all__, *LAZY])}."
        )


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *LAZY})
