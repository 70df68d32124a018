"""Half of a photo, from images to readings or from readings to photos, as kernels compute it."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, ClassVar, Self

import numpy as np
from torch import Tensor

from moireaug.camera import pipeline
from moireaug.common.numeric import as_float
from moireaug.engine.execution import Call
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import HostGeometry


class Stage(ABC):
    """A function of a batch with a gradient of its own."""

    @abstractmethod
    def forward(self, values: Tensor, saves: bool) -> tuple[Tensor, Tensor]:
        """Return the results of values, and a tensor for `backward`; saves: it will be called."""

    @abstractmethod
    def backward(self, grad: Tensor, values: Tensor, saved: Tensor) -> Tensor:
        """Return the gradient in values, from that in the results and what `forward` saved."""

    @abstractmethod
    def reference(self, values: Tensor) -> Tensor:
        """Return the results in PyTorch, which derivatives of the gradient need."""

    @property
    def sums_in_order(self) -> bool:
        """Whether `backward` adds in a fixed order."""
        return True


@dataclass(frozen=True, eq=False)
class KernelStage(Stage):
    """A stage by kernels.

    Args:
        call: whose shot it is of.
        kernels: see `Backend.kernels`.
        effects: names of those that the kernels compute.
        method: of exposing or demosaicing, by name.
    """

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
    def records(self) -> Any:
        """The records of the shot, from `lower`."""
        return self.lower(self.call.host_shot, 1, self.call.geometry)

    @abstractmethod
    def lower(self, shot: ShotRecord, exactness: int, geometry: HostGeometry | None = None) -> Any:
        """Return the records of a shot on the CPU.

        Args:
            exactness: by how much their errors are smaller than a photo's.
            geometry: of the shot, if it is at hand.
        """

    @abstractmethod
    def can_follow(self, records: Any) -> np.ndarray:
        """Return whether kernels can follow each image's records, (B,) bool."""

    @abstractmethod
    def launch(self, values: Tensor, saves: bool, records: Any) -> tuple[Tensor, Tensor]:
        """Return what `forward` does, of the images of some records."""

    def forward(self, values: Tensor, saves: bool) -> tuple[Tensor, Tensor]:
        return self.launch(values, saves, self.records)

    def reference(self, values: Tensor) -> Tensor:
        return pipeline.apply(self.effects, as_float(values), self.shot)

    def variant(self) -> str:
        """Return a name of the kernels, the same only if they are compiled alike."""
        scene = self.shot.scene
        reading = "binned" if scene.is_binned else "full"
        frame = "image" if scene.develop.registered else "camera"
        # registration undoes the one; bins average what the other clips
        others = [name for name in ("lens", "saturate") if name in self.shot.plan]
        stage = (type(self).__name__, self.method, reading, scene.filter_cell, f"{frame} frame")
        return ", ".join((*stage, *self.effects, *others))
