"""An effect: a name, a verdict on a scene, and a function of light and shot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from torch import Tensor

from moireaug.scene.fields import Range, bounds
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class Verdict(NamedTuple):
    """Whether a scene calls for an effect, and the reason, which `print(scene.plan())` shows."""

    called: bool
    reason: str


def called(reason: str) -> Verdict:
    """Return the verdict that an effect is called for."""
    return Verdict(True, reason)


def left_out(reason: str) -> Verdict:
    """Return the verdict that an effect is left out."""
    return Verdict(False, reason)


class Effect(ABC):
    """One physical step. It is left out at its identity, and also where its verdict can tell that
    it changes no value by more than the scene's tolerance."""

    name: str
    is_listed = True  # in a plan; effects that only clip are not
    # with others, scales or shifts them, before codes are clipped: one outside [0, 1] counts
    mixes_readings = False

    @abstractmethod
    def verdict(self, scene: SceneRecord) -> Verdict:
        """Judge by the scene's ranges alone."""

    @abstractmethod
    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        """Return the light after this step. Never modifies its input."""


class WithinExposure(Effect):
    """A step that the exposure integrates, so light passes through unchanged here."""

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return light


def format_range(value: Range) -> str:
    """Return a range as text, such as "0.2 to 0.4"."""
    low, high = bounds(value)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def verdict_of(change: float, scene: SceneRecord, why: str, why_not: str) -> Verdict:
    """Call for an effect that changes some value by more than the tolerance."""
    if change > scene.tolerance:
        return called(why)
    return left_out(f"changes nothing by more than {scene.tolerance:.2g}" if change else why_not)
