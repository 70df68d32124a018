"""Implementations of the operators that `engine.torch_operators` declares: they run
`moireaug.capture`'s stages."""

from __future__ import annotations

import contextlib
import functools
import json
import math
from collections.abc import Callable

import torch
from torch import Tensor

from moireaug.capture import develop, reading_of
from moireaug.engine.backends import BACKENDS
from moireaug.engine.switch import reference
from moireaug.engine.torch_operators import LIBRARY
from moireaug.scene.by_name import values_of
from moireaug.scenes import Scene, Shot

Stage = Callable[[Tensor, Shot], Tensor]


def _shot(numbers: list[Tensor], seeds: Tensor, text: str, size: list[int]) -> Shot:
    """Return the shot that an operator's arguments describe; see `torch_operators.SHOT_SCHEMA`."""
    scene = _scene(text)
    drawn = dict(zip(values_of(scene), numbers, strict=True))
    height, width, whole_height, whole_width, top, left = size
    whole = scene.shot_from_numbers((whole_height, whole_width), drawn, seeds)
    if (height, width) == whole.size:
        return whole
    return whole.crop(top, left, height, width)


@functools.lru_cache(maxsize=64)
def _scene(text: str) -> Scene:
    return Scene.from_dict(json.loads(text))


def _reading_of(light: Tensor, shot: Shot) -> Tensor:
    """Return `reading_of` images whose values a graph has not seen: kernels would look up NaN and
    infinity out of bounds."""
    finite = light.dtype == torch.uint8 or math.isfinite(light.detach().sum())
    with contextlib.nullcontext() if finite else reference():
        return reading_of(light, shot)


def _forward(
    stage: Stage,
    values: Tensor,
    numbers: list[Tensor],
    seeds: Tensor,
    scene: str,
    size: list[int],
    shape: list[int],
) -> Tensor:
    with torch.no_grad():
        return stage(values, _shot(numbers, seeds, scene, size)).contiguous()


def _backward(
    stage: Stage,
    grad: Tensor,
    values: Tensor,
    numbers: list[Tensor],
    seeds: Tensor,
    scene: str,
    size: list[int],
) -> Tensor:
    shot = _shot(numbers, seeds, scene, size)
    with torch.enable_grad():
        values = values.detach().requires_grad_()
        return torch.autograd.grad(stage(values, shot), values, grad)[0].contiguous()


for backend in BACKENDS:
    key = backend.device_type.upper()  # of PyTorch's dispatcher
    for name, stage in (("expose", _reading_of), ("develop", develop)):
        LIBRARY.impl(name, functools.partial(_forward, stage), key)
        LIBRARY.impl(f"{name}_back", functools.partial(_backward, stage), key)
