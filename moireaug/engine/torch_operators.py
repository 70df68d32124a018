"""The stages as operators, which a graph of torch.compile calls as they are. What they do is in
`moireaug.engine.operators`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moireaug.engine import autograd
from moireaug.engine.stage import Stage
from moireaug.scene.shot import ShotRecord

# a shot as an operator takes it: drawn numbers, seeds, scene as JSON, and its size, whole size and
# corner, a pair each
SHOT_SCHEMA = "Tensor[] numbers, Tensor seeds, str scene, SymInt[] size"


@dataclass(frozen=True, eq=False)
class OperatorStage(Stage):
    """A stage by its operator.

    Args:
        name: "expose", from images to readings, or "develop", from readings to photos.
        in_pytorch: the stage's reference.
    """

    name: str
    shot: ShotRecord
    in_pytorch: Callable[[Tensor], Tensor]

    def forward(self, values: Tensor, saves: bool) -> tuple[Tensor, Tensor]:
        shape = (3, *self.shot.size) if self.name == "develop" else self.shot.raw_shape()[1:]
        operator = getattr(torch.ops.moireaug, self.name)
        return operator(values, *self._shot_arguments(), shape), values.new_empty(0)

    def backward(self, grad: Tensor, values: Tensor, saved: Tensor) -> Tensor:
        operator = getattr(torch.ops.moireaug, f"{self.name}_back")
        return operator(grad, values, *self._shot_arguments())

    def reference(self, values: Tensor) -> Tensor:
        return self.in_pytorch(values)

    def _shot_arguments(self) -> tuple[Any, ...]:
        """Return the shot as `SHOT_SCHEMA` takes it."""
        shot = self.shot
        sizes = [*shot.size, *shot.whole_size, *shot.corner]
        return list(shot.numbers().values()), shot.seed, shot.scene.as_json(), sizes

    def __call__(self, values: Tensor) -> Tensor:
        if not (torch.is_grad_enabled() and values.requires_grad):
            return self.forward(values, False)[0]
        return autograd.differentiable(self, values)


def _fake(values, numbers, seeds, scene, size, shape):
    return values.new_empty((len(values), *shape), dtype=torch.float32)


def _fake_back(grad, values, numbers, seeds, scene, size):
    return values.new_empty(values.shape)


# by hand, as in `effects.random_numbers`: `custom_op` imports the compiler
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
for name in ("expose", "develop"):
    LIBRARY.define(f"{name}(Tensor values, {SHOT_SCHEMA}, SymInt[] shape) -> Tensor")
    LIBRARY.define(f"{name}_back(Tensor grad, Tensor values, {SHOT_SCHEMA}) -> Tensor")
    torch.library.register_fake(f"moireaug::{name}", _fake, lib=LIBRARY)
    torch.library.register_fake(f"moireaug::{name}_back", _fake_back, lib=LIBRARY)
