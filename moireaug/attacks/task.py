"""One batch to attack at one bound, and those of its images that still take steps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.problem import Point, Problem


@dataclass(frozen=True, eq=False)
class Task:
    """One batch to attack at one bound.

    Args:
        problem: how noise becomes its images.
        labels: (n,) true classes.
        targets: (n,) classes to reach; None where any wrong class is a success.
        aims: (n,) classes that the loss steers toward; None where it steers away from the label.
        eps: the bound.
        generator: of random starts; None is torch's global one.
    """

    problem: Problem
    labels: Tensor
    targets: Tensor | None
    aims: Tensor | None
    eps: float
    generator: torch.Generator | None


@dataclass(frozen=True, eq=False)
class Active:
    """The images of a task that still take steps.

    Args:
        task: of all n images. problem: of these images alone. rows: (b,) their indices in the
            batch.
    """

    task: Task
    problem: Problem
    rows: Tensor

    @staticmethod
    def every(task: Task) -> Active:
        """Return a task's images, all of them active."""
        rows = torch.arange(len(task.labels), device=task.labels.device)
        return Active(task, task.problem, rows)

    def narrowed(self, rows: Tensor) -> Active:
        """Return the images `rows`, or itself where none is dropped."""
        if len(rows) == len(self.rows):
            return self
        return Active(self.task, self.task.problem.part(rows), rows)

    def point(self, point: Point) -> Point:
        """Return these images' part of a point of all."""
        return {name: self._of(x) for name, x in point.items()}

    def goals(self) -> tuple[Tensor, Tensor | None]:
        """Return these images' labels and aims, repeated for each view."""
        views = self.problem.views
        aims = None if self.task.aims is None else self._of(self.task.aims).repeat(views)
        return self._of(self.task.labels).repeat(views), aims

    def filled(self, values: Tensor) -> Tensor:
        """Return these images' values, (b, ...), among those of all, (n, ...), with 0 for the
        others."""
        n = len(self.task.labels)
        if len(self.rows) == n:
            return values
        return values.new_zeros(n, *values.shape[1:]).index_copy(0, self.rows, values)

    def _of(self, values: Tensor) -> Tensor:
        return values if len(self.rows) == len(values) else values[self.rows]
