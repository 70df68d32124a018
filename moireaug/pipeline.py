"""The path of light: every effect in the order in which light meets it, and the plan of those that
a scene calls for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.effects.base import Effect
from moireaug.effects.demosaic import Demosaic
from moireaug.effects.denoise import Denoise
from moireaug.effects.detail import ChromaBlur, ClipDetail, Sharpen
from moireaug.effects.display import BlackLevel, Glare
from moireaug.effects.exposing import Crosstalk, Distortion, Exposed, Pose, Subpixels
from moireaug.effects.flicker import Flicker
from moireaug.effects.jpeg import Jpeg
from moireaug.effects.prefilter import Prefilter, most_lost
from moireaug.effects.registration import Registration
from moireaug.effects.resize import Resize
from moireaug.effects.sensor import FullWell, Gain, Noise, Quantisation, Saturation
from moireaug.effects.srgb import Clip, Decode, Encode
from moireaug.effects.tone import Brighten, ColourMatrix, ToneCurve, WhiteBalance
from moireaug.effects.vignetting import Vignetting
from moireaug.exposure.base import Exposure
from moireaug.exposure.choose import exposure_of
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

EXPOSE: tuple[Effect, ...] = (
    Decode(),  # codes to light
    BlackLevel(),
    Prefilter(),  # what is too far away
    Subpixels(),  # the next four are integrated by the exposure
    Pose(),
    Distortion(),
    Crosstalk(),
    Exposed(),  # panel light to readings
    Flicker(),  # of the panel, not of the room that its glass reflects
    Glare(),
    Vignetting(),
    Gain(),
    Noise(),
    FullWell(),
)
DEVELOP: tuple[Effect, ...] = (
    Saturation(),  # of the reading and an attacker's noise
    Quantisation(),
    Demosaic(),  # readings to colours
    WhiteBalance(),
    ColourMatrix(),
    Encode(),  # light to codes
    ToneCurve(),
    Brighten(),
    Clip(),
    Denoise(),
    ChromaBlur(),
    Sharpen(),
    ClipDetail(),
    Resize(),  # sensor pixels to photo pixels
    Registration(),  # back to the image's frame
    Jpeg(),
)


def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the raw reading of images (B, 3, H, W): apply the effects before the attacker's noise
    in turn."""
    return apply(shot.plan.exposing, light, shot)


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos (B, 3, H, W) of a raw reading: apply the effects after the attacker's noise
    in turn."""
    return apply(shot.plan.developing, raw, shot)


def apply(effects: tuple[Effect, ...], values: Tensor, shot: ShotRecord) -> Tensor:
    """Apply effects in turn."""
    for effect in effects:
        values = effect(values, shot)
    return values


class Step(NamedTuple):
    """One effect of a plan: its name, whether the scene calls for it, and why or why not."""

    name: str
    called: bool
    reason: str


@dataclass(frozen=True)
class Plan:
    """The effects of a scene, in the order in which light meets them. `"pose" in plan` asks whether
    one is called for.

    Args:
        steps: every effect, called for or not.
        exposing, developing: the effects that are computed before and after the attacker's noise.
        method: the exposure method, "auto" resolved.
        prefilter: the most variance by which the picture is blurred before it is looked up, in
            squared image pixels.
    """

    steps: tuple[Step, ...]
    exposing: tuple[Effect, ...]
    developing: tuple[Effect, ...]
    method: Exposure
    prefilter: float
    _called: frozenset[str] = field(init=False, repr=False)  # a photo asks for dozens of names

    def __post_init__(self) -> None:
        called = frozenset(step.name for step in self.steps if step.called)
        object.__setattr__(self, "_called", called)

    @property
    def exposure(self) -> str:
        """The exposure's name: "spectral", "box", "mean", "point" or "supersample:n"."""
        return self.method.name

    @property
    def harmonics(self) -> tuple[tuple[int, int], ...]:
        """The (k, l) pairs that the spectral exposure sums."""
        return self.method.harmonics

    def __contains__(self, effect: object) -> bool:
        return effect in self._called

    def __iter__(self) -> Iterator[Step]:
        return (step for step in self.steps if step.called)

    def __str__(self) -> str:
        called = [step for step in self.steps if step.called]
        absent = [step for step in self.steps if not step.called]
        width = max(len(step.name) for step in self.steps) + 2
        lines = ["The photo is the image"]
        if called:
            lines = [f"{_counted(called)} computed, in this order"]
        for i, step in enumerate(called, 1):
            lines.append(f"  {i:2d}  {step.name:{width}}{step.reason}")
        if absent:
            lines.append(f"{_counted(absent)} left out")
        for step in absent:
            lines.append(f"   -  {step.name:{width}}{step.reason}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values: effects called for and those left out (each name to reason),
        exposure and harmonics."""
        return {
            "effects": {step.name: step.reason for step in self.steps if step.called},
            "left_out": {step.name: step.reason for step in self.steps if not step.called},
            "exposure": self.exposure,
            "harmonics": [list(pair) for pair in self.harmonics],
        }


def _counted(steps: list[Step]) -> str:
    return "1 effect is" if len(steps) == 1 else f"{len(steps)} effects are"


@torch.no_grad()
def make_plan(scene: SceneRecord) -> Plan:
    """Judge every effect by a scene's ranges; see `Scene.plan`."""
    steps: list[Step] = []
    chosen: dict[str, list[Effect]] = {}
    for stage, effects in (("exposing", EXPOSE), ("developing", DEVELOP)):
        chosen[stage] = []
        for effect in effects:
            verdict = effect.verdict(scene)
            if verdict.called:
                chosen[stage].append(effect)
            if effect.shown:
                steps.append(Step(effect.name, *verdict))
    exposing, developing = (tuple(effects) for effects in chosen.values())
    return Plan(
        tuple(steps),
        exposing,
        developing,
        exposure_of(scene),
        most_lost(scene),
    )


make_plan._torchdynamo_disable = True  # type: ignore[attr-defined]  # torch.compile runs it as it is
