"""The gradient of what kernels compute, for all stages and devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.common.numeric import is_batched
from moireaug.engine.differences import ShotDifferences


class Stage(NamedTuple):
    """A stage of a batch's photos: from images to readings, or from readings to photos.

    Args:
        forward: takes values and whether a gradient is asked for, and returns the stage's results
            and a tensor for `backward`.
        backward: takes the gradient in the results, the values and that tensor, and returns the
            gradient in the values.
        reference: does the same as `forward` in PyTorch, for derivatives of the gradient.
        sums_in_order: see `Backend.kernels`.
        differences: for the gradient in the shot's numbers, if one is asked for.
    """

    forward: Callable[[Tensor, bool], tuple[Tensor, Tensor]]
    backward: Callable[[Tensor, Tensor, Tensor], Tensor]
    reference: Callable[[Tensor], Tensor]
    sums_in_order: bool = True
    differences: ShotDifferences | None = None


class _Differentiable(torch.autograd.Function):
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
        return in_values, None, *stage.differences.gradients(grad, values)


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


def is_asked(values: Tensor) -> bool:
    """Return whether a gradient in the values may be asked for."""
    return torch.is_grad_enabled() and values.requires_grad


def apply(stage: Stage, values: Tensor) -> Tensor:
    """Return a stage's results, differentiable in the values and, by its differences, in the shot's
    numbers."""
    if is_asked(values) or stage.differences is not None:
        numbers = stage.differences.numbers if stage.differences else []
        return _Differentiable.apply(values, stage, *numbers)
    return stage.forward(values, False)[0]
