"""A scene's plans, made once and kept with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from moireaug.camera.pipeline import make_plan
from moireaug.scene.plan import Plan
from moireaug.scene.record import SceneRecord
from moireaug.scene.sized import NOMINAL_SIZE, scene_of_size, size_octave

UNPLANNED_MESSAGE = (
    "torch.compile cannot follow how a scene is planned: call scene.plan(size) before, as "
    "Scene.sample does; copies and unpickled scenes have no plan yet."
)
CACHE_FIELDS = ("_plans", "_json")  # plans by octave, and the scene as JSON, for a graph


@dataclass(frozen=True, kw_only=True)
class PlannedScene(SceneRecord):
    """A scene that keeps its plans; users hold a `Scene`."""

    def plan_effects(self, size: tuple[int, int] = NOMINAL_SIZE) -> Plan:
        """Return `Scene.plan` without the moiré to expect, which takes longer to find; errors as
        there. The same one for all sizes between two powers of 2."""
        octave = size_octave(self, size)
        plans = getattr(self, "_plans", {})  # kept here so that torch.compile finds them ready
        if octave not in plans:
            if torch.compiler.is_compiling():
                raise RuntimeError(UNPLANNED_MESSAGE)
            plans = {**plans, octave: make_plan(scene_of_size(self, size))}
            object.__setattr__(self, "_plans", plans)
            self.as_json()  # made ready: torch.compile cannot follow how
        return plans[octave]

    def __getstate__(self) -> dict[str, Any]:
        """Leave the plans out of copies and pickles: another version may plan otherwise."""
        return {name: value for name, value in vars(self).items() if name not in CACHE_FIELDS}
