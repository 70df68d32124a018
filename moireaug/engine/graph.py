"""The stages as operators, which a graph of torch.compile calls as they are. What they do is in
`moireaug.operators`."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug import pipeline
from moireaug.engine import autograd
from moireaug.shot import ShotRecord

# a shot as an operator takes it: drawn numbers, seeds, scene as JSON, and size
SHOT_SCHEMA = "Tensor[] numbers, Tensor seeds, str scene, SymInt[] size"

# by hand, as in `effects.sensor`: `custom_op` imports the compiler
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
LIBRARY.define(f"expose(Tensor light, {SHOT_SCHEMA}, SymInt[] shape) -> Tensor")
LIBRARY.define(f"develop(Tensor raw, {SHOT_SCHEMA}) -> Tensor")
LIBRARY.define(f"develop_back(Tensor grad, Tensor raw, {SHOT_SCHEMA}) -> Tensor")


def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings of images, without a gradient."""
    return torch.ops.moireaug.expose(light, *_schema_values(shot), shot.raw_shape()[1:])


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos of readings, with a gradient in them."""
    schema = _schema_values(shot)

    def forward(raw: Tensor, _: bool) -> tuple[Tensor, Tensor]:
        return torch.ops.moireaug.develop(raw, *schema), raw.new_empty(0)

    def backward(grad: Tensor, raw: Tensor, _: Tensor) -> Tensor:
        return torch.ops.moireaug.develop_back(grad, raw, *schema)

    stage = autograd.Stage(forward, backward, lambda raw: pipeline.develop(raw, shot))
    return autograd.apply(stage, raw)


def _schema_values(shot: ShotRecord) -> tuple[list[Tensor], Tensor, str, tuple[int, int]]:
    """Return what `SHOT_SCHEMA` lists."""
    text = vars(shot.scene)["_text"]  # which its plan has left there
    return list(shot.numbers().values()), shot.seed, text, shot.size


@torch.library.register_fake("moireaug::expose", lib=LIBRARY)
def _(light, numbers, seeds, scene, size, shape):
    return light.new_empty((len(light), *shape), dtype=torch.float32)


@torch.library.register_fake("moireaug::develop", lib=LIBRARY)
def _(raw, numbers, seeds, scene, size):
    return raw.new_empty((len(raw), 3, *size))


@torch.library.register_fake("moireaug::develop_back", lib=LIBRARY)
def _(grad, raw, numbers, seeds, scene, size):
    return raw.new_empty(raw.shape)
