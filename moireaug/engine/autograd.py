"""The gradient of what kernels compute, for all stages and devices."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from moireaug.common.numeric import is_batched
from moireaug.engine import differences, kernel_check
from moireaug.engine.stage import KernelStage, Stage


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


def run(stage: KernelStage, values: Tensor) -> Tensor:
    """Return a stage's results, differentiable in the values and in the shot's numbers; by the
    reference where its kernels fail on the device of the values."""
    saves = torch.is_grad_enabled() and values.requires_grad
    if not kernel_check.matches_reference(stage, values, back=saves):
        return stage.reference(values)
    if not (saves or stage.call.moved_numbers):
        return stage.forward(values, False)[0]
    numbers = stage.shot.numbers()
    return differentiable(stage, values, *[numbers[name] for name in stage.call.moved_numbers])


def differentiable(stage: Stage, values: Tensor, *numbers: Tensor) -> Tensor:
    """Return a stage's results, differentiable in the values and in some numbers of its shot, (B,)
    float64 each."""
    return _Differentiable.apply(values, stage, *numbers)
