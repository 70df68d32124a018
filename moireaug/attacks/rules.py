"""Update rules: how a step follows from a gradient. A rule is made anew for each run, and holds that run's state."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor

DECAY = 1.0  # of the momentum, Dong et al. (2018)
INERTIA = 0.75  # share of a halving step that is new, the rest repeats the step before: Croce & Hein (2020)
OFTEN = 0.75  # share of the steps that must raise the loss between two checkpoints: Croce & Hein (2020)


class Ball(NamedTuple):
    """Where a variable may go, and in how many steps.

    Args:
        radius: eps for noise, 1 for a pose.
        bound: the largest absolute value: the radius, or infinity for N-FGSM.
        steps: how many will be taken.
        step_size: of the first step, in units of the radius; None is the rule's own.
        base: (B, ...) what the noise is added to, or None where that differs from step to step.
    """

    radius: float
    bound: float
    steps: int
    step_size: float | None = None
    base: Tensor | None = None


class Rule(ABC):
    """One run of one variable: called once a step with the variable, the gradient of the loss to it, both (B, ...), and
    the loss of each image, (B,); returns the variable after the step. All ascend."""

    def __init__(self, ball: Ball) -> None:
        self.ball = ball
        self.step = ball.radius * (self.usual(ball.steps) if ball.step_size is None else ball.step_size)

    @staticmethod
    def usual(steps: int) -> float:
        """The step size where none is given, in units of the radius."""
        return min(1.0, 2.5 / max(1, steps))

    def confine(self, x: Tensor) -> Tensor:
        """Pull back into the ball."""
        return x.clamp(-self.ball.bound, self.ball.bound)

    @abstractmethod
    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor: ...


class Sign(Rule):
    """x + step sign(gradient), pulled back into the ball (Madry et al., 2018)."""

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        return self.confine(x + self.step * gradient.sign())


class Momentum(Rule):
    """MI-FGSM (Dong et al., 2018, Algorithm 1): steps along the sign of g = DECAY g + gradient / mean|gradient|, with
    the mean over each image."""

    def __init__(self, ball: Ball) -> None:
        super().__init__(ball)
        self.past: Tensor | float = 0.0

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        size = gradient.abs().flatten(1).mean(1)
        self.past = DECAY * self.past + gradient / _per_image(torch.where(size > 0, size, 1.0), x)
        return self.confine(x + self.step * self.past.sign())


class Halving(Rule):
    """In the manner of APGD (Croce & Hein, 2020, Algorithm 1): bold first steps of 2 radii with inertia. At each
    checkpoint an image's step is halved, and its search goes on from the best point so far, where its loss rose in
    fewer than `OFTEN` of the steps since the last checkpoint, or where neither step nor best loss changed since.

    Unlike in the paper, a search that starts again from the best point has no inertia there.
    """

    def __init__(self, ball: Ball) -> None:
        super().__init__(ball)
        self.k, self.checks = 0, checkpoints(ball.steps)

    @staticmethod
    def usual(steps: int) -> float:
        return 2.0

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        if self.k == 0:
            self.size = torch.full_like(loss, self.step)
            self.best = self.last = self.best_then = loss
            self.best_x = self.before = x
            self.best_gradient = gradient
            self.rose, self.since = torch.zeros_like(loss), 0
            self.halved = torch.ones_like(loss, dtype=torch.bool)
        better = loss > self.best
        self.best = torch.where(better, loss, self.best)
        self.best_x = choose(better, x, self.best_x)
        self.best_gradient = choose(better, gradient, self.best_gradient)
        self.rose = self.rose + (loss > self.last)
        self.last = loss
        if self.k in self.checks:
            x, gradient = self._check(x, gradient)
        aim = self.confine(x + _per_image(self.size, x) * gradient.sign())
        inertia = INERTIA if self.k else 1.0
        after = self.confine(x + inertia * (aim - x) + (1 - inertia) * (x - self.before))
        self.before, self.k, self.since = x, self.k + 1, self.since + 1
        return after

    def _check(self, x: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
        stuck = (self.rose < OFTEN * self.since) | (~self.halved & (self.best <= self.best_then))
        self.size = torch.where(stuck, self.size / 2, self.size)
        self.last = torch.where(stuck, self.best, self.last)
        self.before = choose(stuck, self.best_x, self.before)
        self.halved, self.best_then = stuck, self.best
        self.rose, self.since = torch.zeros_like(self.rose), 0
        return choose(stuck, self.best_x, x), choose(stuck, self.best_gradient, gradient)


class Printed(Rule):
    """The order in which the paper's Algorithm 1 is printed: delta = clip(delta + eps / K sign(gradient)), then
    x_{k+1} = clip(x_k + delta), for K steps.

    Each step adds the whole delta to a reading that carries all earlier ones, so that the L-infinity bound holds for
    delta and not for what is added: that reaches up to (1 + 2 + ... + K) eps / K = (K + 1) / 2 eps, plus the random
    start where there is one. "sign" develops the one reading plus delta instead, and stays within eps. The variable is
    the total of what was added: x_k less the reading x_0, which the clipping of x_k to [0, 1] is a part of.
    """

    def __init__(self, ball: Ball) -> None:
        super().__init__(ball)
        self.delta: Tensor | float = 0.0

    @staticmethod
    def usual(steps: int) -> float:
        return 1.0 / max(1, steps)

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        self.delta = self.confine(self.delta + self.step * gradient.sign())
        return (self.ball.base + x + self.delta).clamp(0, 1) - self.ball.base


RULES: dict[str, type[Rule]] = {"sign": Sign, "momentum": Momentum, "halving": Halving, "printed": Printed}


def checkpoints(steps: int) -> set[int]:
    """The steps at which "halving" looks back: ceil(p_j steps), with p_0 = 0, p_1 = 0.22 and
    p_{j+1} = p_j + max(p_j - p_{j-1} - 0.03, 0.06) (Croce & Hein, 2020, section 4)."""
    before, p, found = 0.0, 0.22, set()
    while p < 1:
        found.add(math.ceil(p * steps - 1e-9))
        before, p = p, p + max(p - before - 0.03, 0.06)
    return found


def _per_image(values: Tensor, like: Tensor) -> Tensor:
    """(B,) as (B, 1, ...), of the dtype of what it scales."""
    return values.to(like.dtype).view(-1, *[1] * (like.ndim - 1))


def choose(rows: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """`a` in the rows (B,) that are True, `b` in the others."""
    return torch.where(rows.view(-1, *[1] * (a.ndim - 1)), a, b)
