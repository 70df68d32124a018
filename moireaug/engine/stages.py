"""The two stages of a photo, from images to readings and from readings to photos: by kernels where
they can follow an image's view, and by the reference from the first effect on for which there are
none."""

from __future__ import annotations

import dataclasses
import functools
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from moireaug.camera import pipeline
from moireaug.camera.effects.prefilter import MAX_NEIGHBOUR_VARIANCE, is_blurred
from moireaug.engine import kernel_stage
from moireaug.engine.execution import Call
from moireaug.engine.kernel_stage import KernelStage
from moireaug.engine.operators import OperatorStage, run_kernels
from moireaug.scene.mixed_shot import join_rows
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry

if TYPE_CHECKING:
    from moireaug.engine.lower.development_records import Development
    from moireaug.engine.lower.exposure_records import Exposure, PanelView

DECODING = ("decode", "black_level", "prefilter")  # effects on the picture, before the panel
# scenes of which it was said that the reference computes some of their photos
_reported: set[SceneRecord] = set()


@dataclass(frozen=True, eq=False)
class Exposing(KernelStage):
    """The stage from images (B, 3, H, W), float32 or uint8, to readings.

    is_decoded: the reference decodes, raises to the black level and prefilters the images before,
        as where the blur differs from place to place.
    """

    name = "expose"
    # lens and aperture pass a cycle per sensor pixel or so: phases that are seen turn by 0.01 rad
    max_shift = 0.002

    is_decoded: bool

    def lower(
        self, shot: ShotRecord, exactness: int, geometry: HostGeometry | None = None
    ) -> tuple[Exposure, PanelView]:
        # with the first photo: importing the package would take a tenth longer
        from moireaug.engine.lower.exposure import lower_exposure

        return lower_exposure(shot, geometry, decoded=self.is_decoded, exactness=exactness)

    def can_follow(self, records: tuple[Any, ...]) -> np.ndarray:
        return self.kernels.fits(*records)

    def __call__(self, light: Tensor) -> Tensor:
        if self.is_decoded:
            names = [name for name in self.shot.plan.exposing if name in DECODING]
            light = pipeline.apply(names, light, self.shot)
        return run_kernels(self, light)


def _split(
    mask: Tensor, first: Callable[[Tensor], Tensor], second: Callable[[Tensor], Tensor]
) -> Callable[[Tensor], Tensor]:
    """Return the function of a batch that is one of the images of a mask (B,) bool, and another of
    the others."""
    rows, others = mask.nonzero().flatten(), (~mask).nonzero().flatten()

    def of_both(values: Tensor) -> Tensor:
        return join_rows([rows, others], [first(values[rows]), second(values[others])])

    return of_both


def exposing(call: Call, batch: int = 0) -> Callable[[Tensor], Tensor]:
    """Return the function from a call's images (B, 3, H, W) to their readings; differentiable in
    float images.

    batch: how many images there are, if the call's are only some of them.
    """
    shot, batch = call.shot, batch or len(call.shot)
    reference = functools.partial(pipeline.expose, shot=shot)
    if call.execution.why_not_expose:
        return reference
    if torch.compiler.is_compiling():
        return OperatorStage("expose", shot, reference)
    kernels = kernel_stage.kernels_of(call.execution.backend)
    if kernels is None:
        return reference
    effects, is_decoded = shot.plan.exposing, False
    if shot.plan.prefilter_variance > MAX_NEIGHBOUR_VARIANCE:
        blurred = is_blurred(shot).cpu()
        is_decoded = bool(blurred.all())
        if blurred.any() and not is_decoded:
            first, second = call.part(blurred), call.part(~blurred)
            return _split(blurred, exposing(first, batch), exposing(second, batch))
    if is_decoded:
        effects = tuple(name for name in effects if name not in DECODING)
    stage = Exposing(call, kernels, effects, shot.plan.exposure, is_decoded)
    followed = torch.from_numpy(stage.can_follow(stage.records))
    if followed.all():
        return stage
    _report_unfollowed(shot.scene, int((~followed).sum()), batch)
    if not followed.any():
        return reference
    # each image by itself, so that its reading does not depend on the rest of the batch
    others = functools.partial(pipeline.expose, shot=call.part(~followed).shot)
    return _split(followed, stage.part(followed), others)


def _report_unfollowed(scene: SceneRecord, n: int, total: int) -> None:
    """Say once for each scene how many photos of a batch the reference computes."""
    if scene in _reported:
        return
    _reported.add(scene)
    logging.getLogger("moireaug").warning(
        f"moireaug's kernels cannot follow the views of {n} of these {total} photos, which PyTorch "
        "computes instead; this takes many times longer. Views near the horizon are the usual "
        "reason: narrow the ranges of View.yaw and pitch, or photograph from farther away, with a "
        "smaller View.fov or, of crops, a larger Sensor.focal. This is said once for each scene."
    )


@dataclass(frozen=True, eq=False)
class Developing(KernelStage):
    """The stage from readings (B, planes, h, w) float32 to photos.

    is_finite: the readings are known to be finite.
    """

    name = "develop"
    max_shift = 0.03  # a photo that is registered is smoother than its reading

    is_finite: bool

    def lower(
        self, shot: ShotRecord, exactness: int, geometry: HostGeometry | None = None
    ) -> tuple[Development]:
        from moireaug.engine.lower.development import lower_development

        return (lower_development(shot, self.effects, geometry),)

    def can_follow(self, records: tuple[Any, ...]) -> np.ndarray:
        return np.ones(len(records[0].codes.matrix), bool)

    def __call__(self, raw: Tensor) -> Tensor:
        if self.is_finite:
            photo = run_kernels(self, raw)
            return pipeline.apply(self.call.execution.reference_effects, photo, self.shot)
        finite, checked = finite_images(raw), dataclasses.replace(self, is_finite=True)
        if raw.device.type != "cpu":  # which looks nothing up; to split would wait for it
            return nan_where(~finite, checked(raw))
        if finite.all():
            return checked(raw)
        if not finite.any():
            return pipeline.develop(raw, self.shot)
        # NaN and infinity are not in the tables of the CPU's kernels
        others = functools.partial(pipeline.develop, shot=self.call.part(~finite).shot)
        return _split(finite, checked.part(finite), others)(raw)


def finite_images(raw: Tensor) -> Tensor:
    """Return which images' readings (B, planes, h, w) are finite, (B,) bool."""
    return raw.detach().sum((1, 2, 3)).isfinite()


def nan_where(mask: Tensor, photos: Tensor) -> Tensor:
    """Return photos (B, 3, H, W) with those of a mask (B,) all NaN."""
    return torch.where(mask[:, None, None, None], torch.nan, photos)


def developing(call: Call, *, is_finite: bool = False) -> Callable[[Tensor], Tensor]:
    """Return the function from a call's readings to their photos; differentiable in them.

    is_finite: the readings are known to be finite.
    """
    shot, execution = call.shot, call.execution
    reference = functools.partial(pipeline.develop, shot=shot)
    if execution.why_not_develop:
        return reference
    if torch.compiler.is_compiling():
        return OperatorStage("develop", shot, reference)
    kernels = kernel_stage.kernels_of(execution.backend)
    if kernels is None:
        return reference
    demosaic = shot.scene.develop.demosaic
    return Developing(call, kernels, execution.engine_effects, demosaic, is_finite)
