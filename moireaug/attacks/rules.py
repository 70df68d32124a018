"""Update rules: the step that follows from a gradient. Each run makes its own rule, which holds
that run's state."""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor

from moireaug.attacks.problem import Problem
from moireaug.common.numeric import per_image, select_rows

MOMENTUM_DECAY = 1.0  # mu of Dong et al. (2018)
# share of an APGD step that is new; the rest repeats the step before: Croce & Hein (2020)
APGD_ALPHA = 0.75
# share of the steps that must raise the loss between two checkpoints: Croce & Hein (2020)
APGD_RHO = 0.75


class Rule(ABC):
    """The rule for one variable in one run. A call takes a step uphill: it takes the variable and
    its gradient, (B, ...) each, and the loss of each image, (B,), and returns the variable after
    the step.

    Args:
        radius: eps for noise, 1 for a pose: the L-infinity ball's, in the variable's own units.
        steps: number of steps.
        step_size: size of the first step, in units of the radius; None is the rule's default.
        bound: largest absolute value of the variable: the radius, or infinity for N-FGSM.
        problem: problem whose noise the variable stands for; None for a pose. Noise on a reading or
            image that is given stays where it changes the photo: beyond, it has no gradient.
    """

    def __init__(
        self,
        radius: float,
        steps: int,
        step_size: float | None = None,
        bound: float | None = None,
        problem: Problem | None = None,
    ) -> None:
        self.bound = radius if bound is None else bound
        self.steps, self.problem = steps, problem
        self.step = radius * (self.default_step_size(steps) if step_size is None else step_size)
        self.noise_range = None if problem is None else problem.noise_range()

    @staticmethod
    def default_step_size(steps: int) -> float:
        """Return the default step size, in units of the radius."""
        return min(1.0, 2.5 / max(1, steps))

    def project(self, x: Tensor) -> Tensor:
        """Project into the ball, and into the range where noise changes the photo."""
        x = x.clamp(-self.bound, self.bound)
        return x if self.noise_range is None else x.clamp(*self.noise_range)

    @abstractmethod
    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor: ...


class Sign(Rule):
    """x + step sign(gradient), projected into the ball (Madry et al., 2018)."""

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        return self.project(x + self.step * gradient.sign())


class Momentum(Rule):
    """MI-FGSM (Dong et al., 2018, Algorithm 1): steps along the sign of g = MOMENTUM_DECAY g +
    gradient / mean|gradient|, with the mean over each image."""

    momentum: Tensor | float = 0.0

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        mean_size = gradient.abs().flatten(1).mean(1)
        mean_size = torch.where(mean_size > 0, mean_size, 1.0)
        self.momentum = MOMENTUM_DECAY * self.momentum + gradient / per_image(mean_size, x)
        return self.project(x + self.step * self.momentum.sign())


class APGD(Rule):
    """Auto-PGD (Croce & Hein, 2020, section 3 and Algorithm 1): first steps of 2 radii, with
    momentum.

    z = P(x_k + step sign(gradient)), x_{k+1} = P(x_k + alpha (z - x_k) + (1 - alpha) (x_k -
    x_{k-1})), where P projects into the ball, and the first step is z itself. At each of the
    `checkpoints` an image's step is halved, and its search goes on from the best point so far, on
    either of two conditions: its loss rose in fewer than a share rho of the steps since the last
    checkpoint; or its step was not halved there and its best loss is no better than it was there.

    Choices that the paper leaves open, and differences from it:
        - Every image of a batch has its own step and best point, as in the authors' code.
        - A checkpoint w_j is evaluated before the step from x_{w_j}, as in the authors' code. The
          printed order takes that step first, and discards it where the search goes back: here the
          points are the same, with one gradient fewer.
        - Their code halves at a share of exactly rho, too, counts checkpoints by whole numbers of
          steps rounded down, and does not test the second condition at the first of them. Here all
          three are as printed.
        - After a search goes back, its momentum points from the point before the checkpoint to the
          best one, as in both the paper and the code; and the next loss is compared with the best
          one, as in the paper.
        - Noise on a raw reading is bounded by eps and by the range in which it changes the photo,
          which may go beyond [0, 1]; see `camera`.
        - The best point here is that of the greatest loss; an attack returns that of the greatest
          margin.
    """

    # (B,) each: step size, loss at the previous point, best loss so far and at the last checkpoint,
    # number of rises of the loss since then, and whether the step was halved there
    step_sizes: Tensor
    last_loss: Tensor
    best_loss: Tensor
    checkpoint_loss: Tensor
    n_rises: Tensor
    was_halved: Tensor
    # (B, ...) each: the previous point, the best point and the gradient there
    previous_x: Tensor
    best_x: Tensor
    best_gradient: Tensor

    k = last_checkpoint = 0

    @staticmethod
    def default_step_size(steps: int) -> float:
        return 2.0

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        # a NaN loss is never the best
        loss = loss.nan_to_num(-math.inf, posinf=math.inf, neginf=-math.inf)
        if self.k == 0:
            self._start_search(x, gradient, loss)
        better = loss > self.best_loss
        self.best_loss = torch.where(better, loss, self.best_loss)
        self.best_x = select_rows(better, x, self.best_x)
        self.best_gradient = select_rows(better, gradient, self.best_gradient)
        self.n_rises = self.n_rises + (loss > self.last_loss)
        self.last_loss = loss
        if self.k in checkpoints(self.steps):
            x, gradient = self._check_progress(x, gradient)
        ascended = self.project(x + per_image(self.step_sizes, x) * gradient.sign())
        momentum = (1 - APGD_ALPHA) * (x - self.previous_x) if self.k else 0.0
        next_x = self.project(x + (APGD_ALPHA if self.k else 1.0) * (ascended - x) + momentum)
        self.previous_x = x
        self.k += 1
        return next_x

    def _start_search(self, x: Tensor, gradient: Tensor, loss: Tensor) -> None:
        self.step_sizes = torch.full_like(loss, self.step, dtype=x.dtype)
        self.best_loss = self.last_loss = self.checkpoint_loss = loss
        self.best_x = self.previous_x = x
        self.best_gradient = gradient
        self.n_rises = torch.zeros_like(loss)
        self.was_halved = torch.zeros_like(loss, dtype=torch.bool)

    def _check_progress(self, x: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
        """Halve the steps of images whose search makes no progress, and go back to their best
        points."""
        steps = self.k - self.last_checkpoint
        rose_rarely = self.n_rises < APGD_RHO * steps
        has_stalled = ~self.was_halved & (self.best_loss <= self.checkpoint_loss)
        goes_back = rose_rarely | has_stalled
        self.step_sizes = torch.where(goes_back, self.step_sizes / 2, self.step_sizes)
        self.last_loss = torch.where(goes_back, self.best_loss, self.last_loss)
        self.was_halved, self.checkpoint_loss = goes_back, self.best_loss
        self.n_rises, self.last_checkpoint = torch.zeros_like(self.n_rises), self.k
        return select_rows(goes_back, self.best_x, x), select_rows(
            goes_back, self.best_gradient, gradient
        )


class Printed(Rule):
    """The steps of the paper's Algorithm 1 in the order printed: delta = clip(delta + eps / K
    sign(gradient)), then x_{k+1} = clip(x_k + delta), for K steps.

    Each step adds the whole delta to a reading that carries all earlier ones, so that the
    bound holds for delta and not for the noise: that reaches up to (1 + 2 + ... + K) / K =
    (K + 1) / 2 times the half widths of delta's box (of eps, where that is the same above and
    below), plus the random start where there is one. "sign" develops the one reading plus delta
    instead, and stays in the box. The variable is that of the noise x_k - x_0, where x_0 is the
    reading, and so includes the clipping of x_k to [0, 1].
    """

    delta: Tensor | float = 0.0

    @staticmethod
    def default_step_size(steps: int) -> float:
        return 1.0 / max(1, steps)

    def __call__(self, x: Tensor, gradient: Tensor, loss: Tensor) -> Tensor:
        if self.problem is None or self.problem.base is None:
            raise ValueError(
                "the rule 'printed' needs the reading that noise is added to; got a problem "
                "without one."
            )
        base, box = self.problem.base, self.problem.box
        self.delta = (self.delta + self.step * gradient.sign()).clamp(-self.bound, self.bound)
        reading = (base + box.noise(x) + box.noise(self.delta)).clamp(0, 1)
        return box.variable(reading - base)


RULES: dict[str, type[Rule]] = {
    "sign": Sign,
    "momentum": Momentum,
    "apgd": APGD,
    "printed": Printed,
}


@functools.lru_cache(maxsize=64)
def checkpoints(steps: int) -> set[int]:
    """Return the steps w_j = ceil(p_j steps) at which APGD looks back, j >= 1, with p_0 = 0,
    p_1 = 0.22 and p_{j+1} = p_j + max(p_j - p_{j-1} - 0.03, 0.06) (Croce & Hein, 2020, section
    3.2)."""
    p_before, p, checkpoint_steps = 0.0, 0.22, set()
    while p < 1:
        checkpoint_steps.add(math.ceil(p * steps - 1e-9))
        p_before, p = p, p + max(p - p_before - 0.03, 0.06)
    return checkpoint_steps
