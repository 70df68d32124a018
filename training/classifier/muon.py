"""Muon: gradient descent whose step of a weight matrix is an orthogonal matrix."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor, nn

# An odd quintic that, applied five times, takes singular values in [0.01, 1] to 0.7 to 1.2.
LINEAR, CUBIC, QUINTIC = 3.4445, -4.7750, 2.0315
ITERATIONS = 5
SGD_LR = 5.0  # of the other parameters, in learning rates of the matrices


class Muon(torch.optim.Optimizer):
    """Takes orthogonal steps in weight matrices, and those of SGD in all other parameters.

    A gradient is strong in few directions, and SGD learns mostly in those; an orthogonal step is
    equally long in all. A convolution's weight (out, in, height, width) is taken as a matrix
    (out, in * height * width); a depthwise one, like biases and normalisation, is left to SGD.

    `torch.optim.Muon` refuses convolutions, and works in bfloat16, which is 20 times as slow on a
    processor that does not multiply it.

    Args:
        lr: learning rate, about the singular values of a matrix's step, times sqrt(N / M) where it
            is taller (N) than wide (M). SGD has `sgd_lr` times that rate.
        momentum: Nesterov's momentum, in [0, 1).
        weight_decay: share of a matrix that it loses in each step, in units of lr; the others lose
            nothing.
        sgd_lr: learning rate of SGD, in units of lr.

    Source: K. Jordan et al., "Muon: An optimizer for hidden layers in neural networks" (2024).
    """

    def __init__(
        self,
        params: Iterable[nn.Parameter],
        lr: float,
        momentum: float,
        weight_decay: float,
        sgd_lr: float = SGD_LR,
    ) -> None:
        matrices: list[nn.Parameter] = []
        vectors: list[nn.Parameter] = []
        for p in params:
            hidden = p.ndim > 1 and min(p.shape[:2]) > 1
            (matrices if hidden else vectors).append(p)
        groups = [
            {"params": matrices, "orthogonal": True, "lr": lr},
            {"params": vectors, "orthogonal": False, "lr": sgd_lr * lr},
        ]
        groups = [group for group in groups if group["params"]]
        super().__init__(groups, {"momentum": momentum, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Update all parameters that have a gradient; return what `closure` returns."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is not None:
                    self._update(p, group)
        return loss

    def _update(self, p: nn.Parameter, group: dict[str, Any]) -> None:
        lr, momentum = group["lr"], group["momentum"]
        state = self.state[p]
        if not state:
            state["momentum_buffer"] = torch.zeros_like(p)
        total = state["momentum_buffer"]
        total.mul_(momentum).add_(p.grad)
        step = p.grad + momentum * total
        if group["orthogonal"]:
            step = orthogonal(step.flatten(1)).view(p.shape)
            p.mul_(1 - lr * group["weight_decay"])
        p.sub_(step, alpha=lr)


def orthogonal(matrix: Tensor) -> Tensor:
    """Return a matrix (N, M) with the same singular vectors and singular values of 0.7 to 1.2.

    Those below 0.01 of the matrix's norm stay smaller. It is multiplied by a polynomial of its own
    Gram matrix, so that all but the first and the last product are square, of the shorter side;
    half precision is computed in float32. The result is longer by sqrt(N / M) where N > M.

    Source: Jordan et al. (2024), who apply the polynomial to the whole matrix."""
    rows, columns = matrix.shape
    if rows > columns:
        return (rows / columns) ** 0.5 * orthogonal(matrix.mT).mT
    start = matrix.to(torch.promote_types(matrix.dtype, torch.float32))
    start = start / start.norm().clamp(min=1e-7)
    gram = start @ start.mT
    factor = product = _factor(gram)
    for _ in range(ITERATIONS - 1):
        gram = factor @ gram @ factor  # that of product @ start, as all three commute
        factor = _factor(gram)
        product = factor @ product
    return (product @ start).to(matrix.dtype)


def _factor(gram: Tensor) -> Tensor:
    """Return the factor of one iteration, from a matrix's Gram matrix."""
    factor = CUBIC * gram + QUINTIC * (gram @ gram)
    factor.diagonal().add_(LINEAR)
    return factor
