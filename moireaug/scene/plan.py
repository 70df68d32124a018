"""The effects that a scene calls for, decided before any picture is seen."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from moireaug.scene.exposure_method import ExposureMethod


class PlanStep(NamedTuple):
    """One effect of a plan: its name, whether the scene calls for it, and why or why not."""

    name: str
    called: bool
    reason: str


class Moire(NamedTuple):
    """About how much moiré photos show: the difference from a moiré-free photo, in codes of 255,
    RMS, that a tenth of them stay below, half, and nine tenths."""

    low: float
    median: float
    high: float

    def __str__(self) -> str:
        return (
            f"moiré of about {self.median:.1f} codes in half of the photos, {self.low:.1f} to "
            f"{self.high:.1f} in four of five"
        )


@dataclass(frozen=True)
class Plan:
    """The effects of a scene, in the order in which light meets them. `"pose" in plan` asks whether
    an effect is computed.

    Args:
        steps: all effects but those that only clip, called for or not.
        exposing, developing: names of those that are computed before and after attacker's noise.
        method: exposure method, "auto" resolved.
        prefilter_variance: largest variance of the picture's blur, in squared image pixels.
        needs_every_pixel: an effect before the resize needs every pixel of the sensor.
        scales: how many panel and sensor pixels an image pixel gets, in words.
        moire: see `Scene.expected_moire`; None if it is not known.
    """

    steps: tuple[PlanStep, ...]
    exposing: tuple[str, ...]
    developing: tuple[str, ...]
    method: ExposureMethod
    prefilter_variance: float
    needs_every_pixel: bool = False
    scales: str = ""
    moire: Moire | None = None
    _computed: frozenset[str] = field(init=False, repr=False)  # a photo asks for dozens of names

    def __post_init__(self) -> None:
        object.__setattr__(self, "_computed", frozenset((*self.exposing, *self.developing)))

    @property
    def exposure(self) -> str:
        """The exposure's name: "spectral", "box", "mean", "point" or "supersample:n"."""
        return self.method.name

    @property
    def harmonics(self) -> tuple[tuple[int, int], ...]:
        """The (k, l) pairs that the spectral exposure sums."""
        return self.method.harmonics

    def __contains__(self, effect: object) -> bool:
        return effect in self._computed

    @property
    def called(self) -> tuple[PlanStep, ...]:
        """The steps that the scene calls for."""
        return tuple(step for step in self.steps if step.called)

    @property
    def left_out(self) -> tuple[PlanStep, ...]:
        """The steps that it does not call for."""
        return tuple(step for step in self.steps if not step.called)

    def __str__(self) -> str:
        width = max(len(step.name) for step in self.steps) + 2
        heading = f"{_counted(self.called)} computed, in this order"
        lines = [heading if self.called else "The photo is the image"]
        lines += [f"  {i:2d}  {s.name:{width}}{s.reason}" for i, s in enumerate(self.called, 1)]
        if self.left_out:
            lines.append(f"{_counted(self.left_out)} left out")
        lines += [f"   -  {step.name:{width}}{step.reason}" for step in self.left_out]
        if self.called and self.scales:
            lines.append(self.scales)
        if self.moire:
            lines.append(f"To expect: {self.moire}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values: effects called for and those left out (each name to reason),
        exposure and harmonics."""
        return {
            "effects": {step.name: step.reason for step in self.called},
            "left_out": {step.name: step.reason for step in self.left_out},
            "exposure": self.exposure,
            "harmonics": [list(pair) for pair in self.harmonics],
        }


def _counted(steps: tuple[PlanStep, ...]) -> str:
    return "1 effect is" if len(steps) == 1 else f"{len(steps)} effects are"
