"""Photos by the engine: shots lowered to kernels' records, and what the reference adds."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moireaug.camera import pipeline
from moireaug.camera.effects.prefilter import MAX_NEIGHBOUR_VARIANCE
from moireaug.common.numeric import as_float
from moireaug.engine import autograd, torch_operators, trial
from moireaug.engine.differences import ShotDifferences, without_gradient
from moireaug.engine.program import Program
from moireaug.scene.mixed_shot import in_order
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

# scenes of which it was said that the reference computes some of their photos
_reported: set[SceneRecord] = set()
DECODING = ("decode", "black_level", "prefilter")  # effects on the picture, before the panel

# Sensor pixels by which the panel moves, at most, in a difference of readings: lens and aperture
# pass about a cycle per sensor pixel, so phases that are seen turn by 0.01 rad. A photo that is
# registered is smoother.
MAX_EXPOSE_SHIFT, MAX_DEVELOP_SHIFT = 0.002, 0.03


def engine_reading(light: Tensor, shot: ShotRecord, program: Program) -> Tensor:
    """Return the readings of images (B, 3, H, W), float32 or uint8, as
    `moireaug.camera.pipeline.expose` does for float32; differentiable in float32 images."""
    if torch.compiler.is_compiling():
        return torch_operators.operator_reading(light, shot)
    # with the first photo: importing the package would take a tenth longer
    from moireaug.engine.lower.exposure import lower_exposure

    kernels = trial.kernels_of(program.backend)
    if kernels is None:
        return pipeline.expose(as_float(light), shot)
    # the blur differs from place to place: the reference does it
    varies = shot.plan.prefilter_variance > MAX_NEIGHBOUR_VARIANCE
    lower = functools.partial(lower_exposure, decoded=varies)
    exposure, view = lower(without_gradient(shot.to("cpu")))
    fits = kernels.fits(exposure, view)
    if not fits.all():
        _report_rest(shot.scene, int((~fits).sum()), len(fits))
    if not fits.any():
        return pipeline.expose(as_float(light), shot)
    # each image by itself, so that its reading does not depend on the rest of the batch
    if not fits.all():
        rows, others = (torch.from_numpy(where.nonzero()[0]) for where in (fits, ~fits))
        raw = engine_reading(light[rows], shot[rows], program)
        return in_order(
            [rows, others], [raw, pipeline.expose(as_float(light[others]), shot[others])]
        )
    names = shot.plan.exposing
    if varies:
        light = pipeline.apply([n for n in names if n in DECODING], as_float(light), shot)
        names = tuple(name for name in names if name not in DECODING)
    stage = autograd.Stage(
        functools.partial(kernels.launch_expose, exposure=exposure, view=view),
        functools.partial(kernels.launch_expose_back, exposure=exposure, view=view),
        lambda light: pipeline.apply(names, light, shot),
        kernels.SUMS_IN_ORDER,
        differences_of(
            shot,
            MAX_EXPOSE_SHIFT,
            lambda shot, exactness: lower(shot, exactness=exactness),
            lambda records: kernels.fits(*records),
            lambda light, records: kernels.launch_expose(light, False, *records)[0],
        ),
    )
    kind = _kind_of(f"exposing, {shot.plan.exposure}", names, shot)
    if not trial.agrees(stage, kind, light):
        return stage.reference(as_float(light))
    return autograd.apply(stage, light)


def engine_photo(raw: Tensor, shot: ShotRecord, program: Program) -> Tensor:
    """Return the photos of readings, as `moireaug.camera.pipeline.develop` does; differentiable in
    the readings."""
    if torch.compiler.is_compiling():
        return torch_operators.operator_photo(raw, shot)
    from moireaug.engine.lower.development import lower_development

    kernels = trial.kernels_of(program.backend)
    finite = raw.detach().sum((1, 2, 3)).isfinite().cpu()
    if kernels is None or not finite.any():  # NaN and infinity are not in the kernels' tables
        return pipeline.develop(raw, shot)
    if not finite.all():
        rows, others = finite.nonzero().flatten(), (~finite).nonzero().flatten()
        photos = engine_photo(raw[rows], shot[rows], program)
        return in_order([rows, others], [photos, pipeline.develop(raw[others], shot[others])])
    names, development = program.engine_effects, lower_development(without_gradient(shot))
    stage = autograd.Stage(
        functools.partial(kernels.launch_develop, development=development),
        functools.partial(kernels.launch_develop_back, development=development),
        lambda raw: pipeline.apply(names, raw, shot),
        differences=differences_of(
            shot,
            MAX_DEVELOP_SHIFT,
            lambda shot, _: lower_development(shot),
            lambda development: np.ones(len(development.codes.matrix), bool),
            lambda raw, development: kernels.launch_develop(raw, False, development)[0],
        ),
    )
    kind = _kind_of(f"developing, {shot.scene.develop.demosaic}", names, shot)
    if not trial.agrees(stage, kind, raw):
        return pipeline.apply(program.reference_effects, stage.reference(raw), shot)
    photo = autograd.apply(stage, raw)
    return pipeline.apply(program.reference_effects, photo, shot)


def _report_rest(scene: SceneRecord, n: int, total: int) -> None:
    """Say once for each scene how many photos of a batch the reference computes."""
    if scene in _reported:
        return
    _reported.add(scene)
    logging.getLogger("moireaug").warning(
        f"moireaug's kernels cannot follow the views of {n} of these {total} photos, which PyTorch "
        "computes instead; this takes many times longer. Views near the horizon are the usual "
        "reason: narrow the ranges of View.yaw, pitch and fov. This is said once for each scene."
    )


def differences_of(
    shot: ShotRecord,
    max_shift: float,
    lower: Callable[[ShotRecord, int], Any],
    fits: Callable[[Any], np.ndarray],
    launch: Callable[[Tensor, Any], Tensor],
) -> ShotDifferences | None:
    """Return the ShotDifferences of a stage, or None if no gradient in the shot is asked for;
    others: its fields."""
    if not (torch.is_grad_enabled() and shot.requires_grad):
        return None
    names = [name for name, values in shot.numbers().items() if values.requires_grad]
    return ShotDifferences(shot.to("cpu"), tuple(names), max_shift, lower, fits, launch)


def _kind_of(stage: str, names: Sequence[str], shot: ShotRecord) -> str:
    """Return a name of a stage's kernels, by the options of the scene that they are compiled for.

    names: of the effects that they compute.
    """
    scene = shot.scene
    reading = "binned" if scene.is_binned else "full"
    frame = "image" if scene.develop.registered else "camera"
    # registration undoes the one; bins average what the other clips
    others = [name for name in ("lens", "saturate") if name in shot.plan]
    return ", ".join((stage, reading, scene.filter_cell, f"{frame} frame", *names, *others))
