"""Who computes photos, decided before a picture is met: which kernels, and what is left to the
reference."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from moireaug.camera import pipeline
from moireaug.common.numeric import may_be_dual
from moireaug.engine.backends import BACKENDS, Backend, backend_of, why_no_kernels
from moireaug.scene.plan import Plan
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry
from moireaug.scene.sized import scene_of_size

ENGINE_EXPOSURES = ("spectral", "mean", "point")
ENGINE_DTYPES = (torch.float32, torch.uint8)
# effects that kernels know: all of exposing is theirs; of developing see `_engine_effects_of`
ENGINE_EXPOSING = {
    *("decode", "black_level", "prefilter", "layout", "pose", "lens", "crosstalk", "exposure"),
    *("flicker", "glare", "vignetting", "gain", "noise", "clip_reading"),
}
ENGINE_DEVELOPING = {
    *("saturate", "bits", "demosaic", "balance", "colour_matrix", "encode", "tone_curve"),
    *("brighten", "clip", "chroma_blur", "sharpen", "clip_detail", "resize", "register"),
}


class Execution(NamedTuple):
    """Who computes what of a scene's photos.

    Args:
        backend: whose kernels run, if any do; None if there are none for the device.
        why_not_expose, why_not_develop: why the reference does all of it; "" where kernels run.
        engine_effects: names of the developing effects that kernels compute.
        reference_effects: names of those after them, for which there are none.
    """

    backend: Backend | None
    why_not_expose: str
    why_not_develop: str
    engine_effects: tuple[str, ...]
    reference_effects: tuple[str, ...]


def execution_of(
    scene: SceneRecord, plan: Plan, device_type: str = "cpu", why_not: str = ""
) -> Execution:
    """Return the Execution of a scene's photos of this plan.

    why_not: why kernels cannot take a call's tensors, whatever the scene; "" if they can.
    """
    effects = _engine_effects_of(scene, plan)
    backend = backend_of(device_type)
    off = why_no_kernels(device_type) or why_not
    if backend and not backend.reads_full and not scene.is_binned:
        off = off or f"{backend.name} kernels take binned readings alone"
    return Execution(
        backend,
        off or _why_not_expose(plan),
        off or _why_not_develop(plan, effects),
        effects,
        plan.developing[len(effects) :],
    )


@dataclass(frozen=True, eq=False)
class Call:
    """A call of `capture`, `expose` or `develop`: one shot, and who computes it.

    Args:
        table: the shot's numbers, from `host_numbers`; None where they are unknown, see
            `numeric.is_transformed`.
        moved_numbers: names of those in which a gradient may be asked for.
    """

    shot: ShotRecord
    table: np.ndarray | None
    execution: Execution
    moved_numbers: tuple[str, ...]

    def part(self, mask: Tensor) -> Call:
        """Return the call of the images of a mask (B,) alone."""
        table = None if self.table is None else self.table[:, mask.numpy()]
        return replace(self, shot=self.shot[mask.to(self.shot.device)], table=table)

    @functools.cached_property
    def geometry(self) -> HostGeometry:
        """The shot's geometry in arrays."""
        return self.shot.host_geometry(self.table)

    @functools.cached_property
    def host_shot(self) -> ShotRecord:
        """The shot on the CPU, without a gradient in its numbers."""
        if self.shot.device.type == "cpu" and not self.moved_numbers:
            return self.shot
        numbers = {name: torch.from_numpy(row) for name, row in self.geometry.numbers().items()}
        return self.shot.with_numbers(numbers, self.shot.seed.cpu())


def call_of(
    shot: ShotRecord, table: np.ndarray | None, values: Tensor, noise: Tensor | None = None
) -> Call:
    """Return the Call of photographing images (B, 3, H, W), or of developing readings.

    Args:
        table: see `Call`.
        noise: to be added to the images' readings.
    """
    moved_numbers: tuple[str, ...] = ()
    if torch.is_grad_enabled():
        drawn = shot.numbers().items()
        moved_numbers = tuple(name for name, one in drawn if one.requires_grad)
    why_not = _why_not_accepted(values) or _why_not_differentiated(shot, values, noise)
    if moved_numbers and torch.compiler.is_compiling():
        why_not = "a gradient in the shot is asked for within torch.compile"
    execution = execution_of(shot.scene, shot.plan, values.device.type, why_not)
    if moved_numbers and not execution.why_not_expose:
        execution = execution._replace(why_not_expose=_why_not_moved(shot.plan))
    return Call(shot, table, execution, moved_numbers)


def explain(scene: SceneRecord) -> str:
    """Return who computes a scene's photos on each type of device that has kernels, and why: a line
    for exposing, one for developing and one for the gradient in the shot. float64, forward-mode and
    second derivatives are the reference's.

    Single images of a shot may still go to the reference, if kernels cannot follow their view. On
    the CPU: near the horizon (more of them the tighter the tolerance); panels of far more pixels
    than the sensor; motion blur that vanishes somewhere in a sharp photo; in the camera's frame,
    from so far away that a pixel sees more cells than its taps. On a GPU: near the horizon.

    Raises:
        TypeError: not a scene.
    """
    if not isinstance(scene, SceneRecord):
        raise TypeError(
            f"scene must be a Scene; got {scene!r}. For a preset, pass Scene.preset(name)."
        )
    plan, lines = pipeline.make_plan(scene_of_size(scene)), []
    for backend in BACKENDS:
        execution = execution_of(scene, plan, backend.device_type)
        reasons = {"expose": execution.why_not_expose, "develop": execution.why_not_develop}
        for stage, reason in reasons.items():
            by = f"reference: {reason}" if reason else f"{backend.name} kernels, in float32"
            if stage == "develop" and execution.reference_effects and not reason:
                by += f"; reference from {execution.reference_effects[0]!r} on"
            lines.append(f"{stage:8} on {backend.device_type:6} {by}")
        reason = execution.why_not_expose or _why_not_moved(plan) or execution.why_not_develop
        by = f"reference: {reason}" if reason else f"differences of {backend.name} kernels"
        lines.append(f"gradient on {backend.device_type:6} in the shot: {by}")
    return "\n".join(lines)


def _why_not_accepted(values: Tensor) -> str:
    if type(values) not in (Tensor, torch.nn.Parameter):
        return "tensor subclasses are not supported"
    if not values.numel():
        return "there is nothing to compute"
    if values.dtype not in ENGINE_DTYPES:
        return f"the engine computes in float32, not {str(values.dtype).removeprefix('torch.')}"
    return ""


def _why_not_differentiated(shot: ShotRecord, values: Tensor, noise: Tensor | None) -> str:
    given = [values] if noise is None else [values, noise]
    if forward_ad._current_level >= 0:  # else no number can be dual, which spares asking each
        given += shot.numbers().values()
    if any(map(may_be_dual, given)):
        return "a forward derivative, or one by torch.func, is asked for"
    return ""


def _why_not_moved(plan: Plan) -> str:
    """Return why differences of readings are no gradient in the shot, or an empty string."""
    if "exposure" in plan and not plan.method.differentiable_in_shot:
        return f"readings of the exposure {plan.method.name!r} have no slope in the shot"
    return ""


def _why_not_expose(plan: Plan) -> str:
    if "exposure" not in plan:
        return "nothing is exposed"
    if unknown := [name for name in plan.exposing if name not in ENGINE_EXPOSING]:
        return f"the engine has no kernel for {unknown[0]!r}"
    if plan.method.name not in ENGINE_EXPOSURES:
        return f"the engine has no exposure {plan.method.name!r}"
    return ""


def _engine_effects_of(scene: SceneRecord, plan: Plan) -> tuple[str, ...]:
    """Return the names of the developing effects that kernels compute: all of theirs, or where
    another effect comes before the last of them, those up to the clip, or none."""
    names, known = plan.developing, ENGINE_DEVELOPING
    if scene.is_rectified:  # what the photo does not show is the reference's
        known = known - {"register"}
    first = next((k for k, name in enumerate(names) if name not in known), len(names))
    if known.isdisjoint(names[first:]):
        return names[:first]
    end = names.index("clip") + 1
    return names[:end] if end <= first else ()


def _why_not_develop(plan: Plan, effects: tuple[str, ...]) -> str:
    if not any(step in plan for step in ("demosaic", "resize", "register", "encode")):
        return "the engine would be no faster"
    if not effects:
        unknown = next(name for name in plan.developing if name not in ENGINE_DEVELOPING)
        return f"the engine has no kernel for {unknown!r}"
    return ""
