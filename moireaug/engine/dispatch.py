"""Photos by the engine: shots lowered to kernels' records, and what the reference adds."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug import pipeline
from moireaug.effects.demosaic import merged_greens
from moireaug.effects.prefilter import MAX_NEIGHBOUR_VARIANCE
from moireaug.engine import graph
from moireaug.engine.program import program_of
from moireaug.mixed_shot import in_order
from moireaug.numeric import as_float, saturate
from moireaug.shot import ShotRecord


@torch.no_grad()
def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings of images (B, 3, H, W), float32 or uint8, as `moireaug.pipeline.expose`
    does for float32."""
    if torch.compiler.is_compiling():
        return graph.expose(light, shot)
    from moireaug.engine.cpu import run
    from moireaug.engine.shot_exposure import lower_exposure

    # over the image: the reference does that blur
    varies = shot.plan.prefilter > MAX_NEIGHBOUR_VARIANCE
    exposure, beats = lower_exposure(shot, decoded=varies)
    fits = run.fits(exposure, beats)
    if not fits.any():
        return pipeline.expose(as_float(light), shot)
    # each image by itself, so that its reading does not depend on the rest of the batch
    if not fits.all():
        raw = torch.empty(shot.raw_shape(), dtype=torch.float32, device="cpu")
        rows, others = torch.from_numpy(fits), torch.from_numpy(~fits)
        raw[rows] = expose(light[rows], shot[rows])
        raw[others] = pipeline.expose(as_float(light[others]), shot[others])
        return raw
    if varies:
        light = as_float(light)
        names = {"decode", "black_level", "prefilter"}.intersection(shot.plan.exposing)
        light = pipeline.apply(names, light, shot)
    return run.expose(light, exposure, beats)


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos of readings, as `moireaug.pipeline.develop` does; differentiable in the
    readings."""
    if torch.compiler.is_compiling():
        return graph.develop(raw, shot)
    from moireaug.engine.cpu import run
    from moireaug.engine.shot_development import lower_development

    finite = raw.detach().sum((1, 2, 3)).isfinite()
    if not finite.any():  # NaN and infinity are not in the kernels' tables
        return pipeline.develop(raw, shot)
    if not finite.all():
        rows, others = finite.nonzero().flatten(), (~finite).nonzero().flatten()
        photos = develop(raw[rows], shot[rows]), pipeline.develop(raw[others], shot[others])
        return in_order([rows, others], photos)
    if shot.scene.cells == "binned":
        # saturated before the greens are averaged; the rest is that of pixels that read all colours
        raw = merged_greens(saturate(raw) if "saturate" in shot.plan else raw)
    program = program_of(shot.scene, shot.plan)
    first = program.engine_effects
    if shot.scene.cells == "binned":
        first = tuple(name for name in first if name not in ("saturate", "demosaic"))

    def reference(raw: Tensor) -> Tensor:
        return pipeline.apply(first, raw, shot)

    photo = run.develop(raw, lower_development(shot), reference)
    return pipeline.apply(program.reference_effects, photo, shot)
