"""The engine in a graph of torch.compile: operators, which it calls as they are."""

from __future__ import annotations

import functools
import json
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from moireaug.scene.by_name import parts_with, values_of
from moireaug.scene.shot import ShotRecord

if TYPE_CHECKING:
    from moireaug.scene.scene import Shot

# a shot as an operator takes it: drawn numbers, seeds, scene as JSON, and size
SHOT = "Tensor[] numbers, Tensor seeds, str scene, SymInt[] size"


def expose(light: Tensor, shot: ShotRecord) -> Tensor:
    """Return the readings of images, without a gradient."""
    return torch.ops.moireaug.expose(light, *_given(shot), shot.raw_shape()[1:])


def develop(raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return the photos of readings, with a gradient in them."""
    return torch.ops.moireaug.develop(raw, *_given(shot))


def _given(shot: ShotRecord) -> tuple[list[Tensor], Tensor, str, tuple[int, int]]:
    """Return what `SHOT` lists."""
    text = vars(shot.scene)["_text"]  # which its plan has left there
    return list(shot.numbers().values()), shot.seed, text, shot.size


def _shot(numbers: list[Tensor], seeds: Tensor, text: str, size: list[int]) -> Shot:
    """Return the shot that `_given` took apart."""
    from moireaug.scene.scene import Shot

    scene = _scene(text)
    parts = parts_with(scene, dict(zip(values_of(scene), numbers, strict=True)))
    return Shot(scene=scene, size=(size[0], size[1]), seed=seeds, **parts)


@functools.lru_cache(maxsize=64)
def _scene(text: str) -> Any:
    from moireaug.scene.scene import Scene

    return Scene.from_dict(json.loads(text))


@torch.no_grad()
def _expose(light: Tensor, *given: Any) -> Tensor:
    from moireaug.capture import reading_of

    return reading_of(light, _shot(*given[:-1])).contiguous()


@torch.no_grad()
def _develop(raw: Tensor, *given: Any) -> Tensor:
    from moireaug.capture import develop

    return develop(raw, _shot(*given)).contiguous()


@torch.enable_grad()
def _develop_back(raw: Tensor, grad: Tensor, *given: Any) -> Tensor:
    from moireaug.capture import develop

    raw = raw.detach().requires_grad_()
    return torch.autograd.grad(develop(raw, _shot(*given)), raw, grad)[0].contiguous()


def _keep(ctx: Any, inputs: tuple, output: Tensor) -> None:
    raw, numbers, seeds, ctx.scene, ctx.size = inputs
    ctx.save_for_backward(raw, seeds, *numbers)


def _backward(ctx: Any, grad: Tensor) -> tuple:
    raw, seeds, *numbers = ctx.saved_tensors
    back = torch.ops.moireaug.develop_back(raw, grad, numbers, seeds, ctx.scene, ctx.size)
    return back, [None] * len(numbers), None, None, None


# by hand, as in `effects.sensor`: `custom_op` imports the compiler
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
LIBRARY.define(f"expose(Tensor light, {SHOT}, SymInt[] shape) -> Tensor")
LIBRARY.define(f"develop(Tensor raw, {SHOT}) -> Tensor")
LIBRARY.define(f"develop_back(Tensor raw, Tensor grad, {SHOT}) -> Tensor")
LIBRARY.impl("expose", _expose, "CPU")
LIBRARY.impl("develop", _develop, "CPU")
LIBRARY.impl("develop_back", _develop_back, "CPU")


@torch.library.register_fake("moireaug::expose", lib=LIBRARY)
def _(light, numbers, seeds, scene, size, shape):
    return light.new_empty((len(light), *shape), dtype=torch.float32)


@torch.library.register_fake("moireaug::develop", lib=LIBRARY)
def _(raw, numbers, seeds, scene, size):
    return raw.new_empty((len(raw), 3, *size))


@torch.library.register_fake("moireaug::develop_back", lib=LIBRARY)
def _(raw, grad, numbers, seeds, scene, size):
    return raw.new_empty(raw.shape)


torch.library.register_autograd("moireaug::develop", _backward, setup_context=_keep, lib=LIBRARY)
