"""One batch to attack at one bound, and its images that still take steps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.problem import Point, Problem


@dataclass(frozen=True, eq=False)
class Task:
    """One batch to attack at one bound.

    Args:
        problem: problem of its n images.
        labels: (n,) true classes.
        targets: (n,) classes to reach; None where any wrong class is a success.
        loss_targets: (n,) classes that the loss steers toward; None where it steers away from the
            label.
        eps: bound of the noise, in [0, 1] units.
        generator: CPU generator of random starts; None is torch's global one.
    """

    problem: Problem
    labels: Tensor
    targets: Tensor | None
    loss_targets: Tensor | None
    eps: float
    generator: torch.Generator | None


@dataclass(frozen=True, eq=False)
class ActiveImages:
    """The b images of a task that still take steps.

    Args:
        task: task of all n images.
        problem: problem of the b images.
        rows: (b,) indices of the b images in the batch.
    """

    task: Task
    problem: Problem
    rows: Tensor

    @staticmethod
    def of_all(task: Task) -> ActiveImages:
        """Return all images of a task."""
        rows = torch.arange(len(task.labels), device=task.labels.device)
        return ActiveImages(task, task.problem, rows)

    def subset(self, rows: Tensor) -> ActiveImages:
        """Return the images `rows` of the task, or itself where none is dropped."""
        if len(rows) == len(self.rows):
            return self
        return ActiveImages(self.task, self.task.problem.subset(rows), rows)

    def point(self, point: Point) -> Point:
        """Return the variables of these images, from those of all images."""
        return {name: self._rows_of(x) for name, x in point.items()}

    def goals(self) -> tuple[Tensor, Tensor | None]:
        """Return these images' labels and loss targets, repeated for each view."""
        views, loss_targets = self.problem.views, self.task.loss_targets
        if loss_targets is not None:
            loss_targets = self._rows_of(loss_targets).repeat(views)
        return self._rows_of(self.task.labels).repeat(views), loss_targets

    def scatter(self, values: Tensor) -> Tensor:
        """Put values (b, ...) into rows of a tensor (n, ...), with 0 for the other images."""
        n = len(self.task.labels)
        if len(self.rows) == n:
            return values
        return values.new_zeros(n, *values.shape[1:]).index_copy(0, self.rows, values)

    def _rows_of(self, values: Tensor) -> Tensor:
        return values if len(self.rows) == len(values) else values[self.rows]
