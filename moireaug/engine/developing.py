"""From readings to photos: by kernels, and by the reference from the first effect on for which
there are none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from moireaug.camera import pipeline
from moireaug.engine import autograd, kernel_check
from moireaug.engine.execution import Call
from moireaug.engine.stage import KernelStage, RowSplit
from moireaug.engine.torch_operators import OperatorStage
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry

if TYPE_CHECKING:
    from moireaug.engine.lower.development_records import Development


@dataclass(frozen=True, eq=False)
class Developing(KernelStage):
    """The stage from readings (B, planes, h, w) float32 to photos.

    is_finite: the readings are known to be finite.
    """

    max_shift = 0.03  # a photo that is registered is smoother than its reading

    is_finite: bool

    def lower(
        self, shot: ShotRecord, exactness: int, geometry: HostGeometry | None = None
    ) -> Development:
        from moireaug.engine.lower.development import lower_development

        return lower_development(shot, geometry)

    def can_follow(self, records: Development) -> np.ndarray:
        return np.ones(len(records.codes.matrix), bool)

    def launch(self, values: Tensor, saves: bool, records: Development) -> tuple[Tensor, Tensor]:
        return self.kernels.launch_develop(values, saves, records)

    def backward(self, grad: Tensor, values: Tensor, saved: Tensor) -> Tensor:
        return self.kernels.launch_develop_back(grad, values, saved, self.records)

    def __call__(self, raw: Tensor) -> Tensor:
        if self.is_finite:
            photo = autograd.run(self, raw)
            return pipeline.apply(self.call.execution.reference_effects, photo, self.shot)
        finite, checked = finite_images(raw), dataclasses.replace(self, is_finite=True)
        if raw.device.type != "cpu":  # which looks nothing up; to split would wait for it
            return nan_where(~finite, checked(raw))
        if finite.all():
            return checked(raw)
        if not finite.any():
            return pipeline.develop(raw, self.shot)
        # NaN and infinity are not in the tables of the CPU's kernels
        checked, others = checked.part(finite), self.call.part(~finite).shot
        return RowSplit(finite, checked, lambda raw: pipeline.develop(raw, others))(raw)


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

    def reference(raw: Tensor) -> Tensor:
        return pipeline.develop(raw, shot)

    if execution.why_not_develop:
        return reference
    if torch.compiler.is_compiling():
        return OperatorStage("develop", shot, reference)
    kernels = kernel_check.kernels_of(execution.backend)
    if kernels is None:
        return reference
    demosaic = shot.scene.develop.demosaic
    return Developing(call, kernels, execution.engine_effects, demosaic, is_finite)
