"""The images of a batch that still take steps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.attacks.problem import Point, Problem


@dataclass(frozen=True, eq=False)
class Active:
    """Some images of a batch, and what is searched for them.

    Args:
        whole: of all n images. problem: of these. labels, aims: (n,) of all.
        rows: (b,) which of the batch these are.
    """

    whole: Problem
    problem: Problem
    labels: Tensor
    aims: Tensor | None
    rows: Tensor

    @staticmethod
    def every(problem: Problem, labels: Tensor, aims: Tensor | None) -> Active:
        """Return all images."""
        rows = torch.arange(len(labels), device=labels.device)
        return Active(problem, problem, labels, aims, rows)

    def narrowed(self, rows: Tensor) -> Active:
        """Return those of `rows`, itself where these are as many."""
        if len(rows) == len(self.rows):
            return self
        return Active(self.whole, self.whole.part(rows), self.labels, self.aims, rows)

    def point(self, point: Point) -> Point:
        """Return these images' part of a point of all."""
        return {name: self._of(x) for name, x in point.items()}

    def goals(self) -> tuple[Tensor, Tensor | None]:
        """Return these images' labels and aims, for as many views of each as there are logits."""
        views = self.problem.views
        aims = None if self.aims is None else self._of(self.aims).repeat(views)
        return self._of(self.labels).repeat(views), aims

    def filled(self, values: Tensor) -> Tensor:
        """Return these images' values, (b, ...), among all, (n, ...), where the others' are 0."""
        n = len(self.labels)
        if len(self.rows) == n:
            return values
        return values.new_zeros(n, *values.shape[1:]).index_copy(0, self.rows, values)

    def _of(self, values: Tensor) -> Tensor:
        return values if len(self.rows) == len(values) else values[self.rows]
