"""The capture in a graph of torch.compile: operators, which it calls as they are. What they do is
in `moireaug.operators`."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from moireaug.shot import ShotRecord

# a shot as an operator takes it: drawn numbers, seeds, scene as JSON, and size
SHOT_SCHEMA = "Tensor[] numbers, Tensor seeds, str scene, SymInt[] size"


def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings of images, without a gradient."""
    return torch.ops.moireaug.expose(light, *_schema_values(shot), shot.raw_shape()[1:])


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos of readings, with a gradient in them."""
    return torch.ops.moireaug.develop(raw, *_schema_values(shot))


def _schema_values(shot: ShotRecord) -> tuple[list[Tensor], Tensor, str, tuple[int, int]]:
    """Return what `SHOT_SCHEMA` lists."""
    text = vars(shot.scene)["_text"]  # which its plan has left there
    return list(shot.numbers().values()), shot.seed, text, shot.size


def _save(ctx: Any, inputs: tuple, output: Tensor) -> None:
    raw, numbers, seeds, ctx.scene, ctx.size = inputs
    ctx.save_for_backward(raw, seeds, *numbers)


def _backward(ctx: Any, grad: Tensor) -> tuple:
    raw, seeds, *numbers = ctx.saved_tensors
    back = torch.ops.moireaug.develop_back(raw, grad, numbers, seeds, ctx.scene, ctx.size)
    return back, [None] * len(numbers), None, None, None


# by hand, as in `effects.sensor`: `custom_op` imports the compiler
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
LIBRARY.define(f"expose(Tensor light, {SHOT_SCHEMA}, SymInt[] shape) -> Tensor")
LIBRARY.define(f"develop(Tensor raw, {SHOT_SCHEMA}) -> Tensor")
LIBRARY.define(f"develop_back(Tensor raw, Tensor grad, {SHOT_SCHEMA}) -> Tensor")


@torch.library.register_fake("moireaug::expose", lib=LIBRARY)
def _(light, numbers, seeds, scene, size, shape):
    return light.new_empty((len(light), *shape), dtype=torch.float32)


@torch.library.register_fake("moireaug::develop", lib=LIBRARY)
def _(raw, numbers, seeds, scene, size):
    return raw.new_empty((len(raw), 3, *size))


@torch.library.register_fake("moireaug::develop_back", lib=LIBRARY)
def _(raw, grad, numbers, seeds, scene, size):
    return raw.new_empty(raw.shape)


torch.library.register_autograd("moireaug::develop", _backward, setup_context=_save, lib=LIBRARY)
