"""Update rules: how a step follows from a gradient. Each run makes its own rule, which holds that
run's state."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor

DECAY = 1.0  # of the momentum, Dong et al. (2018)
# share of an APGD step that is new, the rest repeats the step before: Croce & Hein (2020)
ALPHA = 0.75
# share of the steps that must raise the loss between two checkpoints: Croce & Hein (2020)
RHO = 0.75


class Ball(NamedTuple):
    """Where a variable may go, and in how many steps.

    Args:
        radius: eps for noise, 1 for a pose.
        bound: the largest absolute value: the radius, or infinity for N-FGSM.
        steps: how many will be taken.
        step_size: of the first step, in units of the radius; None is the rule's default.
        base: (B, ...) what the noise is added to, or None where that differs from step to step.
        felt: the least and greatest values of base + noise, beyond which more noise changes
            nothing, and so has no gradient: where base is given, the noise is kept inside.
    """

    radius: float
    bound: float
    steps: int
    step_size: float | None = None
    base: Tensor | None = None
    felt: tuple[float, float] = (-math.inf, math.inf)


class Rule(ABC):
    """The rule for one variable in one run: called at each step with the variable, the loss's
    gradient with respect to it, both (B, ...), and the loss of each image, (B,); returns the
    variable after the step. All rules ascend."""

    def __init__(self, ball: Ball) -> None:
        self.ball = ball
        self.room: tuple[Tensor, Tensor] | None = None
        if ball.base is not None and ball.felt != (-math.inf, math.inf):
            self.room = ball.felt[0] - ball.base, ball.felt[1] - ball.base
        self.step = ball.radius * (
            self.usual(ball.steps) if ball.step_size is None else ball.step_size
        )

    @staticmethod
    def usual(steps: int) -> float:
        """Return the default step size, in units of the radius."""
        return min(1.0, 2.5 / max(1, steps))

    def confine(self, x: Tensor) -> Tensor:
        """Clip to the ball, and to the range where noise changes the photo."""
        x = x.clamp(-self.ball.bound, self.ball.bound)
        return x if self.room is None else x.clamp(*self.room)

    @abstractmethod
    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor: ...


class Sign(Rule):
    """x + step sign(gradient), pulled back into the ball (Madry et al., 2018)."""

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        return self.confine(x + self.step * gradient.sign())


class Momentum(Rule):
    """MI-FGSM (Dong et al., 2018, Algorithm 1): steps along the sign of g = DECAY g + gradient /
    mean|gradient|, with the mean over each image."""

    def __init__(self, ball: Ball) -> None:
        super().__init__(ball)
        self.past: Tensor | float = 0.0

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        size = gradient.abs().flatten(1).mean(1)
        self.past = DECAY * self.past + gradient / _per_image(torch.where(size > 0, size, 1.0), x)
        return self.confine(x + self.step * self.past.sign())


class APGD(Rule):
    """Auto-PGD (Croce & Hein, 2020, section 3 and Algorithm 1): first steps of 2 radii, with
    momentum.

    z = P(x_k + step sign(gradient)), x_{k+1} = P(x_k + ALPHA (z - x_k) + (1 - ALPHA) (x_k -
    x_{k-1})), where P projects into the ball, and the first step is z itself. At each of the
    `checkpoints` an image's step is halved, and its search goes on from the best point so far, on
    either of two conditions: its loss rose in fewer than RHO of the steps since the last
    checkpoint; or its step was not halved there and its best loss is no better than it was there.

    What the paper leaves open, and what differs here:
        - Every image of a batch has its own step and best point, as in the authors' code.
        - A checkpoint w_j is evaluated before the step from x_{w_j}, as in the authors' code. The
          printed order takes that step first, and discards it where the search goes back: here the
          points are the same, with one gradient fewer.
        - Their code halves at a share of exactly RHO, too, counts checkpoints by whole numbers of
          steps rounded down, and does not test the second condition at the first of them. Here all
          three are as printed.
        - After a search goes back, its momentum points from the point before the checkpoint to the
          best one, as in both the paper and the code; and the next loss is compared with the best
          one, as in the paper.
        - Noise on a raw reading is bounded by eps and, above, by the full well: a reading may go
          below 0, where it still changes the photo.
        - The best point here is that of the greatest loss; what an attack returns is that of the
          greatest margin.
    """

    # per image, (B,): its step, its loss at the point before, its best loss so far and at the last
    # checkpoint, how often the loss rose since then, and whether the step was halved there
    size: Tensor
    last: Tensor
    best: Tensor
    best_then: Tensor
    rises: Tensor
    halved: Tensor
    # (B, ...): the point before, the best one and the gradient there
    before: Tensor
    best_x: Tensor
    best_gradient: Tensor

    def __init__(self, ball: Ball) -> None:
        super().__init__(ball)
        self.k = self.since = 0
        self.checks = checkpoints(ball.steps)

    @staticmethod
    def usual(steps: int) -> float:
        return 2.0

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        # a NaN loss is never the best
        loss = loss.nan_to_num(-math.inf, posinf=math.inf, neginf=-math.inf)
        if self.k == 0:
            self._begin(x, gradient, loss)
        better = loss > self.best
        self.best = torch.where(better, loss, self.best)
        self.best_x = choose(better, x, self.best_x)
        self.best_gradient = choose(better, gradient, self.best_gradient)
        self.rises = self.rises + (loss > self.last)
        self.last = loss
        if self.k in self.checks:
            x, gradient = self._look_back(x, gradient)
        aim = self.confine(x + _per_image(self.size, x) * gradient.sign())
        momentum = (1 - ALPHA) * (x - self.before) if self.k else 0.0
        after = self.confine(x + (ALPHA if self.k else 1.0) * (aim - x) + momentum)
        self.before = x
        self.k += 1
        return after

    def _begin(self, x: Tensor, gradient: Tensor, loss: Tensor) -> None:
        self.size = torch.full_like(loss, self.step, dtype=x.dtype)
        self.best = self.last = self.best_then = loss
        self.best_x = self.before = x
        self.best_gradient = gradient
        self.rises = torch.zeros_like(loss)
        self.halved = torch.zeros_like(loss, dtype=torch.bool)

    def _look_back(self, x: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
        """Halve steps at a checkpoint, and go back to the best points there."""
        steps = self.k - self.since
        seldom = self.rises < RHO * steps
        stuck = ~self.halved & (self.best <= self.best_then)
        back = seldom | stuck
        self.size = torch.where(back, self.size / 2, self.size)
        self.last = torch.where(back, self.best, self.last)
        self.halved, self.best_then = back, self.best
        self.rises, self.since = torch.zeros_like(self.rises), self.k
        return choose(back, self.best_x, x), choose(back, self.best_gradient, gradient)


class Printed(Rule):
    """The steps of the paper's Algorithm 1 in the order printed: delta = clip(delta + eps / K
    sign(gradient)), then x_{k+1} = clip(x_k + delta), for K steps.

    Each step adds the whole delta to a reading that carries all earlier ones, so that the
    L-infinity bound holds for delta and not for what is added: that reaches up to (1 + 2 + ... + K)
    eps / K = (K + 1) / 2 eps, plus the random start where there is one. "sign" develops the one
    reading plus delta instead, and stays within eps. The variable is all that was added, x_k minus
    the reading x_0, and so includes the clipping of x_k to [0, 1].
    """

    def __init__(self, ball: Ball) -> None:
        super().__init__(ball)
        self.delta: Tensor | float = 0.0

    @staticmethod
    def usual(steps: int) -> float:
        return 1.0 / max(1, steps)

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        base, bound = self.ball.base, self.ball.bound
        if base is None:
            raise ValueError(
                "the rule 'printed' needs the reading that noise is added to; got Ball(base=None)."
            )
        self.delta = (self.delta + self.step * gradient.sign()).clamp(-bound, bound)
        return (base + x + self.delta).clamp(0, 1) - base


RULES: dict[str, type[Rule]] = {
    "sign": Sign,
    "momentum": Momentum,
    "apgd": APGD,
    "printed": Printed,
}


def checkpoints(steps: int) -> set[int]:
    """Return the steps w_j = ceil(p_j steps) at which APGD looks back, j >= 1, with p_0 = 0,
    p_1 = 0.22 and p_{j+1} = p_j + max(p_j - p_{j-1} - 0.03, 0.06) (Croce & Hein, 2020, section
    3.2)."""
    before, p, found = 0.0, 0.22, set()
    while p < 1:
        found.add(math.ceil(p * steps - 1e-9))
        before, p = p, p + max(p - before - 0.03, 0.06)
    return found


def _per_image(values: Tensor, like: Tensor) -> Tensor:
    """Return (B,) as (B, 1, ...), in the dtype of what it scales."""
    return values.to(like.dtype).view(-1, *[1] * (like.ndim - 1))


def choose(rows: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return `a` in the rows (B,) that are True, `b` in the others."""
    return torch.where(rows.view(-1, *[1] * (a.ndim - 1)), a, b)
