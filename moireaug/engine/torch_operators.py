"""The stages as operators, which a graph of torch.compile calls as they are. What they do is in
`moireaug.engine.operators`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from moireaug.camera import pipeline
from moireaug.engine import autograd
from moireaug.scene.shot import ShotRecord

# a shot as an operator takes it: drawn numbers, seeds, scene as JSON, and its size, whole size and
# corner, a pair each
SHOT_SCHEMA = "Tensor[] numbers, Tensor seeds, str scene, SymInt[] size"


def operator_reading(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings of images, differentiable in them."""
    return _apply("expose", light, shot, shot.raw_shape()[1:], pipeline.expose)


def operator_photo(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos of readings, differentiable in them."""
    return _apply("develop", raw, shot, (3, *shot.size), pipeline.develop)


def _apply(
    name: str, values: Tensor, shot: ShotRecord, shape: Sequence[int], reference: Callable
) -> Tensor:
    """Return what a stage's operator makes of values, (B, *shape)."""
    operator = getattr(torch.ops.moireaug, name)
    operator_back = getattr(torch.ops.moireaug, f"{name}_back")
    sizes = [*shot.size, *shot.whole_size, *shot.corner]
    given = list(shot.numbers().values()), shot.seed, shot.scene.as_json(), sizes

    def forward(values: Tensor, _: bool) -> tuple[Tensor, Tensor]:
        return operator(values, *given, shape), values.new_empty(0)

    def backward(grad: Tensor, values: Tensor, _: Tensor) -> Tensor:
        return operator_back(grad, values, *given)

    stage = autograd.Stage(forward, backward, lambda values: reference(values, shot))
    return autograd.apply(stage, values)


def _fake(values, numbers, seeds, scene, size, shape):
    return values.new_empty((len(values), *shape), dtype=torch.float32)


def _fake_back(grad, values, numbers, seeds, scene, size):
    return values.new_empty(values.shape)


# by hand, as in `effects.random_numbers`: `custom_op` imports the compiler
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
for stage in ("expose", "develop"):
    LIBRARY.define(f"{stage}(Tensor values, {SHOT_SCHEMA}, SymInt[] shape) -> Tensor")
    LIBRARY.define(f"{stage}_back(Tensor grad, Tensor values, {SHOT_SCHEMA}) -> Tensor")
    torch.library.register_fake(f"moireaug::{stage}", _fake, lib=LIBRARY)
    torch.library.register_fake(f"moireaug::{stage}_back", _fake_back, lib=LIBRARY)
