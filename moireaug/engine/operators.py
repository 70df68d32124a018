"""Implementations of the operators that `engine.torch_operators` declares: they run the stages of
`moireaug.capture`."""

from __future__ import annotations

import contextlib
import functools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.engine.backends import BACKENDS
from moireaug.engine.switch import reference
from moireaug.engine.torch_operators import LIBRARY
from moireaug.scene.by_name import values_of
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.shot import ShotRecord

ShotFunction = Callable[[Tensor, ShotRecord], Tensor]


@dataclass(frozen=True)
class OperatorImplementation:
    """A stage as an operator, which takes a shot as `torch_operators.SHOT_SCHEMA`.

    Args:
        stage: computes it, of values and their shot.
        scene_from_json: makes a scene of the text that an operator is given.
    """

    stage: ShotFunction
    scene_from_json: Callable[[str], Any]

    def forward(
        self,
        values: Tensor,
        numbers: list[Tensor],
        seeds: Tensor,
        scene: str,
        size: list[int],
        shape: list[int],
    ) -> Tensor:
        """Return what the stage makes of values."""
        with torch.no_grad():
            return self.stage(values, self._shot(numbers, seeds, scene, size)).contiguous()

    def backward(
        self,
        grad: Tensor,
        values: Tensor,
        numbers: list[Tensor],
        seeds: Tensor,
        scene: str,
        size: list[int],
    ) -> Tensor:
        """Return the gradient in the values, of the gradient in what the stage makes of them."""
        shot = self._shot(numbers, seeds, scene, size)
        with torch.enable_grad():
            values = values.detach().requires_grad_()
            return torch.autograd.grad(self.stage(values, shot), values, grad)[0].contiguous()

    def _shot(self, numbers: list[Tensor], seeds: Tensor, text: str, size: list[int]) -> ShotRecord:
        scene = self.scene_from_json(text)
        drawn = dict(zip(values_of(scene), numbers, strict=True))
        height, width, whole_height, whole_width, top, left = size
        whole = scene.shot_from_numbers((whole_height, whole_width), drawn, seeds)
        if (height, width) == whole.size:
            return whole
        return whole.crop(top, left, height, width)


def implement(
    reading_of: ShotFunction,
    develop: ShotFunction,
    scene_from_dict: Callable[[dict[str, Any]], Any],
) -> None:
    """Register the operators of both stages for every device that has kernels.

    Args:
        reading_of, develop: the stages, as in `moireaug.capture`.
        scene_from_dict: `Scene.from_dict`.
    """

    def finite_reading_of(light: Tensor, shot: ShotRecord) -> Tensor:
        """Read images whose values a graph has not seen: kernels would look up NaN and infinity out
        of bounds."""
        finite = light.dtype == torch.uint8 or math.isfinite(light.detach().sum())
        with contextlib.nullcontext() if finite else reference():
            return reading_of(light, shot)

    @functools.lru_cache(maxsize=MAX_CACHED_SCENES)
    def scene_from_json(text: str) -> Any:
        return scene_from_dict(json.loads(text))

    for name, stage in (("expose", finite_reading_of), ("develop", develop)):
        operator = OperatorImplementation(stage, scene_from_json)
        for backend in BACKENDS:
            key = backend.device_type.upper()  # of PyTorch's dispatcher
            LIBRARY.impl(name, operator.forward, key)
            LIBRARY.impl(f"{name}_back", operator.backward, key)
