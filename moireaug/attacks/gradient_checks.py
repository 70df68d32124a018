"""Checks of a model's gradient: none is not one of zeros, which a camera would make of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

NO_GRADIENT_MESSAGE = (
    "the model's logits have no gradient: it runs under torch.no_grad, detaches, is quantised, or "
    "computes in integers or outside torch. Pass a differentiable model, or search without "
    "gradients: attacks.SquareMoire."
)


def check_differentiable(logits: Tensor) -> None:
    """Refuse logits without a gradient: ValueError."""
    if not logits.requires_grad:
        raise ValueError(NO_GRADIENT_MESSAGE)


def check_gradient(gradients: Sequence[Tensor | None]) -> None:
    """Refuse gradients none of which is defined: ValueError."""
    if all(gradient is None for gradient in gradients):
        raise ValueError(NO_GRADIENT_MESSAGE)


def watched_copy(images: Tensor) -> Tensor:
    """Return a copy of images for a model, which may work in place. A backward pass that brings no
    gradient to it, because an operator of the model has none, raises the ValueError of
    `check_gradient`: on its way through a camera, no gradient would become one of zeros."""
    copy = images.clone()
    if copy.grad_fn is not None and not torch.compiler.is_compiling():
        copy.grad_fn.register_prehook(check_gradient)
    return copy


def keep_undefined(logits: Tensor) -> None:
    """Let a backward pass from logits leave a gradient undefined where it is: an autograd.Function
    is else given zeros in its place, and passes them on."""
    nodes: list[Any] = [logits.grad_fn]
    visited: set[Any] = {None}
    for node in nodes:  # which grows
        if node not in visited and node.next_functions:  # else a weight's own, which stays
            visited.add(node)
            node.register_hook(_undefined_if_undefined)
            nodes += [following for following, _ in node.next_functions]


def _undefined_if_undefined(
    inward: Sequence[Tensor | None], outward: Sequence[Tensor | None]
) -> tuple[None, ...] | None:
    """Return no gradients in place of a node's gradients in its inputs, where those in its results
    are not defined."""
    return (None,) * len(inward) if all(gradient is None for gradient in outward) else None
