"""Stages as PyTorch calls them: with a gradient of their own, and as operators, which a graph of
torch.compile calls as they are."""

from __future__ import annotations

import contextlib
import functools
import itertools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Union

import torch
from torch import Tensor

from moireaug.common.numeric import is_batched
from moireaug.engine import differences, kernel_stage
from moireaug.engine.backends import BACKENDS, reference
from moireaug.engine.kernel_stage import KernelStage
from moireaug.scene.by_name import values_of
from moireaug.scene.draws import MAX_CACHED_SCENES
from moireaug.scene.shot import ShotRecord

# a shot as an operator takes it: drawn numbers, seeds, scene as JSON, and its size and, of a part,
# whole size and corner, a pair each
SHOT_SCHEMA = "Tensor[] numbers, Tensor seeds, str scene, SymInt[] size"

Stage = Union["KernelStage", "OperatorStage"]
MAX_KEPT = 2  # results of an operator, for gradients that are still to come
ShotFunction = Callable[[Tensor, ShotRecord], Tensor]


class _Differentiable(torch.autograd.Function):
    """A stage's results, differentiable in the values and in some numbers of its shot, (B,) float64
    each."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, stage: Stage, *numbers: Tensor) -> Tensor:
        results, saved = stage.forward(values, ctx.needs_input_grad[0])
        ctx.save_for_backward(values, saved, *numbers)
        ctx.stage = stage
        ctx.set_materialize_grads(False)  # no gradient is not one of zeros
        return results

    @staticmethod
    def backward(ctx: Any, grad: Tensor | None) -> tuple[Tensor | None, ...]:
        stage, (values, saved, *numbers) = ctx.stage, ctx.saved_tensors
        if grad is None:
            return None, None, *[None for _ in numbers]
        if torch.compiler.is_compiling():
            return stage.backward(grad, values, saved), None
        twice = torch.is_grad_enabled()  # the gradient itself is to be differentiated
        ordered = stage.sums_in_order or not torch.are_deterministic_algorithms_enabled()
        if twice or not ordered or is_batched(grad):
            return _reference_gradients(ctx, grad, create_graph=twice)
        in_values = stage.backward(grad, values, saved) if ctx.needs_input_grad[0] else None
        if not numbers:
            return in_values, None
        return in_values, None, *differences.gradients(stage, grad, values)


def _reference_gradients(
    ctx: Any, grad: Tensor, *, create_graph: bool
) -> tuple[Tensor | None, ...]:
    """Return what `_Differentiable.backward` does, by the reference."""
    values, _, *numbers = ctx.saved_tensors
    inputs = [values, *numbers] if ctx.needs_input_grad[0] else numbers
    # autocast may be on where backward is called
    with torch.enable_grad(), torch.autocast(grad.device.type, enabled=False):
        results = ctx.stage.reference(values)
        found = torch.autograd.grad(
            results, inputs, grad, create_graph=create_graph, allow_unused=bool(numbers)
        )
    in_values = found[: len(inputs) - len(numbers)] or (None,)
    return *in_values, None, *found[len(inputs) - len(numbers) :]


def run_kernels(stage: KernelStage, values: Tensor) -> Tensor:
    """Return a stage's results, differentiable in the values and in the shot's numbers; by the
    reference where its kernels fail on the device of the values."""
    saves = torch.is_grad_enabled() and values.requires_grad
    if not kernel_stage.matches_reference(stage, values, back=saves):
        return stage.reference(values)
    if not (saves or stage.call.moved_numbers):
        return stage.forward(values, False)[0]
    numbers = stage.shot.numbers()
    moved = [numbers[name] for name in stage.call.moved_numbers]
    return _Differentiable.apply(values, stage, *moved)


@dataclass(frozen=True, eq=False)
class OperatorStage:
    """A stage by its operator; for its methods, see `KernelStage`.

    name: "expose", from images to readings, or "develop", from readings to photos.
    """

    name: str
    shot: ShotRecord
    reference: Callable[[Tensor], Tensor]
    sums_in_order = True

    def forward(self, values: Tensor, saves: bool) -> tuple[Tensor, Tensor]:
        shape = (3, *self.shot.size) if self.name == "develop" else self.shot.raw_shape()[1:]
        operator = getattr(torch.ops.moireaug, self.name)
        return operator(values, *self._shot_arguments(), shape, saves)

    def backward(self, grad: Tensor, values: Tensor, saved: Tensor) -> Tensor:
        operator = getattr(torch.ops.moireaug, f"{self.name}_back")
        return operator(grad, values, saved, *self._shot_arguments())

    def _shot_arguments(self) -> tuple[Any, ...]:
        """Return the shot as `SHOT_SCHEMA` takes it."""
        shot = self.shot
        sizes = [*shot.size]
        if shot.part_of is not None:  # also of the whole, whose photo is not dark around
            sizes += [*shot.whole_size, *shot.corner]
        return list(shot.numbers().values()), shot.seed, shot.scene.as_json(), sizes

    def __call__(self, values: Tensor) -> Tensor:
        if not (torch.is_grad_enabled() and values.requires_grad):
            return self.forward(values, False)[0]
        return _Differentiable.apply(values, self)


# by hand, as in `effects.random_numbers`: `custom_op` imports the compiler
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
for name in ("expose", "develop"):
    given = f"{SHOT_SCHEMA}, SymInt[] shape, bool saves"
    LIBRARY.define(f"{name}(Tensor values, {given}) -> (Tensor results, Tensor ticket)")
    LIBRARY.define(
        f"{name}_back(Tensor grad, Tensor values, Tensor ticket, {SHOT_SCHEMA}) -> Tensor"
    )
    torch.library.register_fake(
        f"moireaug::{name}",
        lambda values, *given: (
            values.new_empty((len(values), *given[-2]), dtype=torch.float32),
            torch.empty(1, dtype=torch.int64, device="cpu"),
        ),
        lib=LIBRARY,
    )
    torch.library.register_fake(
        f"moireaug::{name}_back",
        lambda grad, values, *given: values.new_empty(values.shape),
        lib=LIBRARY,
    )


class _Operator:
    """A stage as an operator, and its gradient.

    The last results with a gradient are kept for it, by tickets: what kernels save has a shape that
    a graph does not know before. A gradient that finds none computes its results again.

    shot_of: function from a shot as `SHOT_SCHEMA` describes it.
    """

    def __init__(self, stage: ShotFunction, shot_of: Callable[..., ShotRecord]) -> None:
        self.stage, self.shot_of = stage, shot_of
        self.tickets = itertools.count(1)
        self.kept: dict[int, tuple[Tensor, Tensor]] = {}

    def _run(self, values: Tensor, shot: Any, saves: bool) -> tuple[Tensor, Tensor]:
        """Return a leaf of the values, and its results."""
        with torch.set_grad_enabled(saves):
            leaf = values.detach().requires_grad_(saves)
            return leaf, self.stage(leaf, self.shot_of(*shot))

    def forward(self, values: Tensor, *given: Any) -> tuple[Tensor, Tensor]:
        *shot, _, saves = given
        leaf, results = self._run(values, shot, saves)
        ticket = 0
        if results.requires_grad:
            ticket = next(self.tickets)
            self.kept[ticket] = leaf, results
            for oldest in list(self.kept)[:-MAX_KEPT]:
                self.kept.pop(oldest, None)
        return results.detach().contiguous(), torch.tensor([ticket], device="cpu")

    def backward(self, grad: Tensor, values: Tensor, ticket: Tensor, *shot: Any) -> Tensor:
        kept = self.kept.pop(int(ticket), None)
        leaf, results = kept or self._run(values, shot, True)
        return torch.autograd.grad(results, leaf, grad)[0].contiguous()


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

    def shot_of(numbers: list[Tensor], seeds: Tensor, text: str, size: list[int]) -> ShotRecord:
        """Return the shot that `SHOT_SCHEMA` describes."""
        scene = scene_from_json(text)
        drawn = dict(zip(values_of(scene), numbers, strict=True))
        height, width, *part = size
        if not part:
            return scene.shot_from_numbers((height, width), drawn, seeds)
        whole_height, whole_width, top, left = part
        whole = scene.shot_from_numbers((whole_height, whole_width), drawn, seeds)
        return whole.crop(top, left, height, width)

    for name, stage in (("expose", finite_reading_of), ("develop", develop)):
        operator = _Operator(stage, shot_of)
        for backend in BACKENDS:
            key = backend.device_type.upper()  # of PyTorch's dispatcher
            LIBRARY.impl(name, operator.forward, key)
            LIBRARY.impl(f"{name}_back", operator.backward, key)
