"""What the engine computes of a scene's photos, and what it leaves to the reference."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.autograd import forward_ad

from moireaug import pipeline
from moireaug.engine.switch import why_unavailable
from moireaug.numeric import may_be_dual
from moireaug.plan import Plan
from moireaug.scene.record import SceneRecord
from moireaug.shot import ShotRecord

ENGINE_EXPOSURES = ("spectral", "mean", "point")


class Program(NamedTuple):
    """Which execution computes what of a photo on the CPU.

    Args:
        why_not_expose, why_not_develop: why the reference does all of it; "" where the engine runs.
        engine_effects: names of the developing effects that kernels compute.
        reference_effects: names of those after them, for which there are none.
    """

    why_not_expose: str
    why_not_develop: str
    engine_effects: tuple[str, ...]
    reference_effects: tuple[str, ...]


def program_of(scene: SceneRecord, plan: Plan) -> Program:
    """Return how a scene's photos of this plan are computed, without a gradient in image or shot.

    The engine has no kernel for the denoiser, for what follows it, for JPEG and, of bins in the
    image's frame, for what the photo does not show.
    """
    names = plan.developing
    unknown = ("denoise", "register", "jpeg") if scene.is_rectified else ("denoise", "jpeg")
    first = min([len(names), *[names.index(name) for name in unknown if name in names]])
    off = why_unavailable()
    return Program(
        off or _why_not_expose(plan), off or _why_not_develop(plan), names[:first], names[first:]
    )


def explain(scene: SceneRecord) -> str:
    """Return which execution a scene gets on the CPU without a gradient in image or shot, and why:
    one line for exposing and one for developing.

    Some views are exposed by the reference all the same, which is decided for each image of a shot:
    near the horizon, the more so for a tight tolerance, of far more panel than sensor pixels, of
    motion that vanishes somewhere in a sharp photo, and, in the camera's frame, from so far away
    that a pixel sees too many cells.

    Raises:
        TypeError: not a scene.
    """
    if not isinstance(scene, SceneRecord):
        raise TypeError(
            f"scene must be a Scene; got {scene!r}. For a preset, pass Scene.preset(name)."
        )
    program = program_of(scene, pipeline.make_plan(scene.at()))
    lines = []
    for stage, reason in (("expose", program.why_not_expose), ("develop", program.why_not_develop)):
        line = f"reference: {reason}" if reason else "engine, on the CPU in float32"
        if stage == "develop" and program.reference_effects and not reason:
            line += f"; reference from {program.reference_effects[0]!r} on"
        lines.append(f"{stage:8} {line}")
    return "\n".join(lines)


def can_expose(light: Tensor, shot: ShotRecord) -> bool:
    """Return whether the engine can expose these images (B, 3, H, W)."""
    asks = torch.is_grad_enabled() and (light.requires_grad or shot.requires_grad)
    runs = not asks and _is_plain(light) and not _is_dual(shot)
    return runs and not program_of(shot.scene, shot.plan).why_not_expose


def can_develop(raw: Tensor, shot: ShotRecord) -> bool:
    """Return whether the engine can develop these readings."""
    asks = torch.is_grad_enabled() and shot.requires_grad
    runs = not asks and _is_plain(raw) and not _is_dual(shot)
    return runs and not program_of(shot.scene, shot.plan).why_not_develop


def _is_plain(tensor: Tensor) -> bool:
    """Return whether kernels can read a tensor: on the CPU, float32 or uint8, not empty, and no
    dual number or subclass, which may do as it likes."""
    known = tensor.dtype in (torch.float32, torch.uint8)
    if not known or tensor.device.type != "cpu" or not tensor.numel():
        return False
    return type(tensor) in (Tensor, torch.nn.Parameter) and not may_be_dual(tensor)


def _is_dual(shot: ShotRecord) -> bool:
    """Return whether a forward derivative in a drawn number is asked for."""
    if forward_ad._current_level < 0:  # which spares asking every number
        return False
    return any(may_be_dual(values) for values in shot.numbers().values())


def _why_not_expose(plan: Plan) -> str:
    method = plan.method
    if "exposure" not in plan:
        return "nothing is exposed"
    if method.name not in ENGINE_EXPOSURES:
        return f"the engine has no exposure {method.name!r}"
    return ""


def _why_not_develop(plan: Plan) -> str:
    if not any(step in plan for step in ("demosaic", "resize", "register", "encode")):
        return "the engine would be no faster"
    return ""
