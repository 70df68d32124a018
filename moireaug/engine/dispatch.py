"""Which execution a capture gets: the engine where it can run, the reference elsewhere."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import math
import os
import sys
import threading
from collections.abc import Iterator

import torch
from torch import Tensor
from torch.autograd import forward_ad

from moireaug import pipeline
from moireaug.effects.demosaic import merged_greens
from moireaug.effects.prefilter import MAX_NEIGHBOUR_VARIANCE
from moireaug.engine import graph
from moireaug.numeric import may_be_dual, saturate
from moireaug.plan import Plan
from moireaug.scene.record import SceneRecord
from moireaug.shot import ShotRecord

ENGINE_VARIABLE = "MOIREAUG_ENGINE"  # the environment variable that may force the reference
OFF_VALUES = ("off", "0", "false", "no")  # its values that do, in capitals or not
ON_VALUES = ("", "on", "1", "true", "yes")
NO_JIT_VARIABLE = "NUMBA_DISABLE_JIT"  # numba's own
ENGINE_EXPOSURES = ("spectral", "mean", "point")
_blocks = 0  # `with reference()` blocks that are open, in any thread
_counting = threading.Lock()


@contextlib.contextmanager
def reference() -> Iterator[None]:
    """Force the reference within a `with` block, in all threads. `MOIREAUG_ENGINE=off` forces it
    everywhere."""
    global _blocks
    with _counting:
        _blocks += 1
    try:
        yield
    finally:
        with _counting:
            _blocks -= 1


def explain(scene: SceneRecord) -> str:
    """Return which execution a scene gets on the CPU without a gradient in image or shot, and why:
    one line for exposing and one for developing.

    Some views are exposed by the reference all the same, which is decided for each image of a shot:
    near the horizon, of far more panel than sensor pixels, of motion that vanishes somewhere in a
    sharp photo, and, in the camera's frame, from so far away that a pixel sees too many cells.

    Raises:
        TypeError: not a scene.
    """
    if not isinstance(scene, SceneRecord):
        raise TypeError(
            f"scene must be a Scene; got {scene!r}. For a preset, pass Scene.preset(name)."
        )
    lines, rest = [], finishing(pipeline.make_plan(scene.at()), rectified=scene.is_rectified)
    for stage, reason in reasons(scene).items():
        line = f"reference: {reason}" if reason else "engine, on the CPU in float32"
        if stage == "develop" and rest and not reason:
            line += f"; reference from {rest[0]!r} on"
        lines.append(f"{stage:8} {line}")
    return "\n".join(lines)


def reasons(scene: SceneRecord) -> dict[str, str]:
    """Return why the reference runs each stage, "expose" and "develop", of a scene's capture; ""
    where the engine does."""
    off, plan = _unavailable(), pipeline.make_plan(scene.at())
    return {"expose": off or _no_exposing(plan), "develop": off or _no_developing(plan)}


def can_expose(light: Tensor, shot: ShotRecord) -> bool:
    """Return whether the engine can expose these images (B, 3, H, W)."""
    asks = torch.is_grad_enabled() and (light.requires_grad or shot.requires_grad)
    return not asks and _runs(light) and not _no_exposing(shot.plan) and not _is_dual(shot)


def can_develop(raw: Tensor, shot: ShotRecord) -> bool:
    """Return whether the engine can develop these readings."""
    asks = torch.is_grad_enabled() and shot.requires_grad
    return not asks and _runs(raw) and not _no_developing(shot.plan) and not _is_dual(shot)


@torch.no_grad()
def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings of images (B, 3, H, W), float32 or uint8, as `moireaug.pipeline.expose`
    does for float32."""
    if torch.compiler.is_compiling():
        return graph.expose(light, shot)
    from moireaug.engine import run
    from moireaug.engine.shot_exposure import lower_exposure

    varies = (
        shot.plan.prefilter > MAX_NEIGHBOUR_VARIANCE
    )  # over the image: the reference does that blur
    exposure, beats = lower_exposure(shot, decoded=varies)
    fits = run.fits(exposure, beats)
    if not fits.any():
        return pipeline.expose(as_float(light), shot)
    # each image by itself, so that its reading does not depend on the rest of the batch
    if not fits.all():
        raw = torch.empty(shot.raw_shape(), dtype=torch.float32, device="cpu")
        for rows in (torch.from_numpy(fits), torch.from_numpy(~fits)):
            raw[rows] = expose(light[rows], shot[rows])
        return raw
    if varies:
        light = as_float(light)
        names = ("decode", "black_level", "prefilter")
        light = pipeline.apply((name for name in names if name in shot.plan), light, shot)
    return run.expose(light, exposure, beats)


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos of readings, as `moireaug.pipeline.develop` does; differentiable in the
    readings."""
    if torch.compiler.is_compiling():
        return graph.develop(raw, shot)
    from moireaug.engine import run
    from moireaug.engine.shot_development import lower_development

    if not math.isfinite(raw.detach().sum()):  # NaN and infinity are not in the kernels' tables
        return pipeline.develop(raw, shot)
    if shot.scene.cells == "binned":
        # saturated before the greens are averaged; the rest is that of pixels that read all colours
        raw = merged_greens(saturate(raw) if "saturate" in shot.plan else raw)
    rest = finishing(shot.plan, rectified=shot.scene.is_rectified)
    first = shot.plan.developing[: len(shot.plan.developing) - len(rest)]
    if shot.scene.cells == "binned":
        first = tuple(name for name in first if name not in ("saturate", "demosaic"))

    def reference(raw: Tensor) -> Tensor:
        return pipeline.apply(first, raw, shot)

    return pipeline.apply(rest, run.develop(raw, lower_development(shot), reference), shot)


def finishing(plan: Plan, *, rectified: bool) -> tuple[str, ...]:
    """Return the effects that the engine has no kernel for: the denoiser, all that follows it, JPEG
    and, of bins in the image's frame, what the photo does not show."""
    names = plan.developing
    for name in ("denoise", "register", "jpeg") if rectified else ("denoise", "jpeg"):
        if name in names:
            return names[names.index(name) :]
    return ()


def as_float(images: Tensor) -> Tensor:
    """Return uint8 images as float32 in [0, 1], others unchanged."""
    return images.float() / 255 if images.dtype == torch.uint8 else images


def _runs(tensor: Tensor) -> bool:
    known = tensor.dtype in (torch.float32, torch.uint8)
    if not known or tensor.device.type != "cpu" or not tensor.numel():
        return False
    if may_be_dual(tensor):
        return False
    plain = type(tensor) in (Tensor, torch.nn.Parameter)  # no subclass, which may do as it likes
    return plain and not _unavailable()


def _is_dual(shot: ShotRecord) -> bool:
    """Return whether a forward derivative in a drawn number is asked for."""
    if forward_ad._current_level < 0:  # which spares asking every number
        return False
    return any(may_be_dual(values) for values in shot.numbers().values())


def _unavailable() -> str:
    """Return why no scene gets the engine, or an empty string."""
    if _blocks or _switched_off(os.environ.get(ENGINE_VARIABLE, "")):
        return "the engine is turned off"
    return _without_compiler()


# torch.compile calls it once, and does not follow it
_unavailable._dynamo_marked_constant = True  # type: ignore[attr-defined]


@functools.cache
def _switched_off(value: str) -> bool:
    """Return whether the environment turns the engine off.

    Raises:
        ValueError: a value that says neither.
    """
    if value.lower() not in (*OFF_VALUES, *ON_VALUES):
        raise ValueError(f"{ENGINE_VARIABLE} must be 'off', or unset; got {value!r}.")
    return value.lower() in OFF_VALUES


@functools.cache
def _without_compiler() -> str:
    """Return why no kernel can be compiled, or an empty string."""
    if importlib.util.find_spec("numba") is None:
        return "numba is not installed"
    if _is_jit_disabled():
        return f"{NO_JIT_VARIABLE} is set, and numba compiles nothing"
    return ""


def _is_jit_disabled() -> bool:
    """Return whether numba runs functions as they are, as debuggers and coverage want it; without
    importing numba."""
    config = sys.modules.get("numba.core.config")
    if config is not None:
        return bool(config.DISABLE_JIT)
    try:
        return bool(int(os.environ.get(NO_JIT_VARIABLE, "0")))
    except ValueError:  # numba takes it for 0
        return False


def _no_exposing(plan: Plan) -> str:
    method = plan.method
    if "exposure" not in plan:
        return "nothing is exposed"
    if method.name not in ENGINE_EXPOSURES:
        return f"the engine has no exposure {method.name!r}"
    return ""


def _no_developing(plan: Plan) -> str:
    if not any(step in plan for step in ("demosaic", "resize", "register", "encode")):
        return "the engine would be no faster"
    return ""
