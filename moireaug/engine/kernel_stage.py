"""Half of a photo, from images to readings or from readings to photos, as kernels compute it.

Kernels that cannot be imported, and those of a GPU that fail or differ from the reference on the
first batch that a user gives them, are left alone. They were proved equal on a CPU; drivers and
cards are many.
"""

from __future__ import annotations

import functools
import logging
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor

from moireaug.camera import pipeline
from moireaug.common.numeric import as_float
from moireaug.engine.backends import Backend
from moireaug.engine.execution import Call
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry

# of any photo or reading, in [0, 1]; kernels and reference differ by 1e-4, of near panels by 3e-4
MAX_RMS = 1e-3
# of a gradient, as a share of the reference's length; they differ by 1e-3, and of white pictures,
# where values lie on either side of a limit, by 1e-2 at most
MAX_GRADIENT_ERROR = 0.05
MIN_SLOPE = 1e-3  # a gradient's length over that of the results', at least, in its error
_agreements: dict[tuple[str, torch.dtype, torch.device, bool], bool] = {}


@dataclass(frozen=True, eq=False)
class KernelStage(ABC):
    """A stage by kernels, with a gradient of its own.

    Args:
        call: whose shot it is of.
        kernels: see `Backend.kernels`.
        effects: names of those that the kernels compute.
        method: of exposing or demosaicing, by name.
    """

    name: ClassVar[str]  # "expose" or "develop", after "launch_" in names of `Backend.kernels`
    # sensor pixels by which the panel moves, at most, in a difference of results
    max_shift: ClassVar[float]

    call: Call
    kernels: ModuleType
    effects: tuple[str, ...]
    method: str

    @property
    def shot(self) -> ShotRecord:
        return self.call.shot

    def part(self, mask: Tensor) -> Self:
        """Return the stage of the images of a mask (B,) alone."""
        return replace(self, call=self.call.part(mask))

    @functools.cached_property
    def records(self) -> tuple[Any, ...]:
        """The records of the shot, from `lower`."""
        return self.lower(self.call.host_shot, 1, self.call.geometry)

    @abstractmethod
    def lower(
        self, shot: ShotRecord, exactness: int, geometry: HostGeometry | None = None
    ) -> tuple[Any, ...]:
        """Return the records of a shot on the CPU.

        Args:
            exactness: by how much their errors are smaller than a photo's.
            geometry: of the shot, if it is at hand.
        """

    @abstractmethod
    def can_follow(self, records: tuple[Any, ...]) -> np.ndarray:
        """Return whether kernels can follow each image's records, (B,) bool."""

    def launch(
        self, values: Tensor, saves: bool, records: tuple[Any, ...]
    ) -> tuple[Tensor, Tensor]:
        """Return what `forward` does, of the images of some records."""
        return getattr(self.kernels, f"launch_{self.name}")(values, saves, *records)

    def forward(self, values: Tensor, saves: bool) -> tuple[Tensor, Tensor]:
        """Return the results of values, and a tensor for `backward`; saves: it will be called."""
        return self.launch(values, saves, self.records)

    def backward(self, grad: Tensor, values: Tensor, saved: Tensor) -> Tensor:
        """Return the gradient in values, from that in the results and what `forward` saved."""
        launch_back = getattr(self.kernels, f"launch_{self.name}_back")
        return launch_back(grad, values, saved, *self.records)

    @property
    def sums_in_order(self) -> bool:
        """Whether `backward` adds in a fixed order."""
        return self.kernels.SUMS_IN_ORDER or self.name == "develop"

    def reference(self, values: Tensor) -> Tensor:
        """Return the results in PyTorch, which derivatives of the gradient need."""
        return pipeline.apply(self.effects, values, self.shot)

    def variant(self) -> str:
        """Return a name of the kernels, the same only if they are compiled alike."""
        scene = self.shot.scene
        reading = "binned" if scene.is_binned else "full"
        frame = "image" if scene.develop.registered else "camera"
        # registration undoes the one; bins average what the other clips
        others = [name for name in ("lens", "saturate") if name in self.shot.plan]
        stage = (type(self).__name__, self.method, reading, scene.filter_cell, f"{frame} frame")
        return ", ".join((*stage, *self.effects, *others))


@functools.cache
def kernels_of(backend: Backend) -> ModuleType | None:
    """Return the module of a backend's kernels, prepared, or None if that fails, as where the
    library that compiles them does not go with an installed NumPy or driver, or is a version that
    has changed."""
    try:
        kernels = backend.kernels()
        kernels.prepare()
    except Exception as error:
        _report(f"{backend.name} kernels cannot be imported ({_summary(error)})")
        return None
    return kernels


def matches_reference(stage: KernelStage, values: Tensor, *, back: bool) -> bool:
    """Return whether a stage's kernels give the reference's results on the device of `values`, and
    a gradient if one is asked for. Tried once a process, device, dtype and variant of the kernels,
    and again when a gradient is first asked for, and again after every batch that was too large to
    compare.

    Args:
        values: pictures or readings, (B, C, H, W).
        back: a gradient in the values is asked for.
    """
    if values.device.type == "cpu":
        return True
    variant = stage.variant()
    key = variant, values.dtype, values.device, back
    if key not in _agreements:
        failure = failure_of(stage, values.detach(), back=back)
        if failure is None:
            return True
        _agreements[key] = not failure
        if failure:
            _report(f"GPU kernels ({variant}) {failure} on {values.device}, of {values.dtype}")
    return _agreements[key]


@torch.no_grad()
def failure_of(stage: KernelStage, values: Tensor, *, back: bool) -> str | None:
    """Return how a stage's kernels fail, an empty string if they do not, or None if a batch is too
    large for the reference, which takes more memory.

    back: also call those of the gradient, and compare the first image's: the reference takes many
    times its memory.
    """
    try:
        results, saved = stage.forward(values, back)
        gradient = stage.backward(results, values, saved) if back else None
        is_finite = gradient is None or bool(gradient.isfinite().all())
    except torch.OutOfMemoryError:
        raise  # the batch's fault, not the kernels'
    except Exception as error:  # of a compiler, a driver or a launch
        return f"do not run ({_summary(error)})"
    try:
        rms = (results - stage.reference(values)).square().mean((1, 2, 3)).sqrt()
        share = 0.0 if gradient is None else _gradient_error(stage, values, results, gradient)
    except torch.OutOfMemoryError:
        return None
    if not (rms <= MAX_RMS).all():
        return f"differ from the reference by {rms.max().item():.1g} RMS"
    if not is_finite:
        return "give a gradient that is not finite"
    if not share <= MAX_GRADIENT_ERROR:
        return f"give a gradient that differs from the reference's by {share:.1g} of its length"
    return ""


def _gradient_error(stage: KernelStage, values: Tensor, grad: Tensor, gradient: Tensor) -> float:
    """Return how far the first image's gradient is from the reference's, as a share of that; 0
    where it cannot be asked for: of no images, and under torch.func.

    grad: in the results, of which the gradient in the values was computed.
    """
    if not len(values) or torch._C._are_functorch_transforms_active():
        return 0.0
    first = torch.arange(len(values), device="cpu") == 0
    image = as_float(values[:1]).clone().requires_grad_()
    with torch.enable_grad():
        (expected,) = torch.autograd.grad(stage.part(first).reference(image), image, grad[:1])
    floor = MIN_SLOPE * grad[:1].norm()
    return ((gradient[:1] - expected).norm() / expected.norm().clamp(min=floor)).item()


def _summary(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


def _report(failure: str) -> None:
    logging.getLogger("moireaug").warning(
        f"moireaug's {failure}: PyTorch computes photos instead, which takes longer. Please report "
        "it."
    )
