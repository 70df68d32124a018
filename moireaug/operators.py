"""What the operators of `engine.graph` do: photograph, as the functions of `moireaug.capture`."""

from __future__ import annotations

import contextlib
import functools
import json
import math
from typing import Any

import torch
from torch import Tensor

from moireaug.capture import develop, reading_of
from moireaug.engine.backends import BACKENDS
from moireaug.engine.graph import LIBRARY
from moireaug.engine.switch import reference
from moireaug.scene.by_name import parts_with, values_of
from moireaug.scenes import Scene, Shot


def _shot(numbers: list[Tensor], seeds: Tensor, text: str, size: list[int]) -> Shot:
    """Return the shot that an operator's arguments describe; see `graph.SHOT_SCHEMA`."""
    scene = _scene(text)
    parts = parts_with(scene, dict(zip(values_of(scene), numbers, strict=True)))
    return Shot(scene=scene, size=(size[0], size[1]), seed=seeds, **parts)


@functools.lru_cache(maxsize=64)
def _scene(text: str) -> Scene:
    return Scene.from_dict(json.loads(text))


@torch.no_grad()
def _expose(light: Tensor, *given: Any) -> Tensor:
    # a graph has not seen the values: kernels would look up NaN and infinity out of bounds, and an
    # error would leave gradients switched off
    finite = light.dtype == torch.uint8 or math.isfinite(light.sum())
    with contextlib.nullcontext() if finite else reference():
        return reading_of(light, _shot(*given[:-1])).contiguous()


@torch.no_grad()
def _develop(raw: Tensor, *given: Any) -> Tensor:
    return develop(raw, _shot(*given)).contiguous()


@torch.enable_grad()
def _develop_back(grad: Tensor, raw: Tensor, *given: Any) -> Tensor:
    raw = raw.detach().requires_grad_()
    return torch.autograd.grad(develop(raw, _shot(*given)), raw, grad)[0].contiguous()


for backend in BACKENDS:
    key = backend.device_type.upper()  # of PyTorch's dispatcher
    LIBRARY.impl("expose", _expose, key)
    LIBRARY.impl("develop", _develop, key)
    LIBRARY.impl("develop_back", _develop_back, key)
