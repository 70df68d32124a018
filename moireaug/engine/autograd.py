"""The gradient of what kernels compute, for all stages and devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from moireaug.numeric import is_batched


class Stage(NamedTuple):
    """A stage of a batch's photos: from images to readings, or from readings to photos.

    Args:
        forward: takes values and whether a gradient is asked for, and returns the stage's results
            and a tensor for `backward`.
        backward: takes the gradient in the results, the values and that tensor, and returns the
            gradient in the values.
        reference: does the same as `forward` in PyTorch, for derivatives of the gradient.
        sums_in_order: see `Backend.kernels`.
    """

    forward: Callable[[Tensor, bool], tuple[Tensor, Tensor]]
    backward: Callable[[Tensor, Tensor, Tensor], Tensor]
    reference: Callable[[Tensor], Tensor]
    sums_in_order: bool = True


class _Differentiable(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, stage: Stage) -> Tensor:
        results, saved = stage.forward(values, True)
        ctx.save_for_backward(values, saved)
        ctx.stage = stage
        ctx.set_materialize_grads(False)  # no gradient is not one of zeros
        return results

    @staticmethod
    def backward(ctx: Any, grad: Tensor | None) -> tuple[Tensor | None, None]:
        if grad is None:
            return None, None
        values, saved = ctx.saved_tensors
        if torch.compiler.is_compiling():
            return ctx.stage.backward(grad, values, saved), None
        twice = torch.is_grad_enabled()  # the gradient itself is to be differentiated
        ordered = ctx.stage.sums_in_order or not torch.are_deterministic_algorithms_enabled()
        if ordered and not twice and not is_batched(grad):
            return ctx.stage.backward(grad, values, saved), None
        # autocast may be on where backward is called
        with torch.enable_grad(), torch.autocast(grad.device.type, enabled=False):
            results = ctx.stage.reference(values)
            return torch.autograd.grad(results, values, grad, create_graph=twice)[0], None


def is_asked(values: Tensor) -> bool:
    """Return whether a gradient in the values may be asked for."""
    return torch.is_grad_enabled() and values.requires_grad


def apply(stage: Stage, values: Tensor) -> Tensor:
    """Return a stage's results, differentiable in the values."""
    if is_asked(values):
        return _Differentiable.apply(values, stage)
    return stage.forward(values, False)[0]
