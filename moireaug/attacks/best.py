"""The best point of each image, over the steps and restarts of an attack."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.attacks.answers import has_prediction
from moireaug.attacks.checks import check_classes
from moireaug.attacks.losses import margin, mean_cross_entropy
from moireaug.attacks.problem import Point
from moireaug.attacks.rules import choose

# margin in logits above which an image counts as fooled for good: rounding differs between batches
FOOLED_MARGIN = 1e-3


class BestPoints:
    """Keeps each image's point of the greatest margin, over steps and restarts, and the mean loss
    of each step."""

    def __init__(self, labels: Tensor, targets: Tensor | None, views: int) -> None:
        self.labels, self.targets, self.views = labels, targets, views
        self.point: Point = {}
        self.losses: list[Tensor] = []
        # whether fooled images stop, because the model repeats its answers
        self.stops_fooled = False
        self.margins = torch.full_like(labels, -math.inf, dtype=torch.float32)

    def active_rows(self) -> Tensor:
        """Return the indices of the images that take further steps."""
        stopped = (self.margins > FOOLED_MARGIN) & self.stops_fooled
        return (~stopped).nonzero()[:, 0]

    @property
    def all_stopped(self) -> bool:
        """Whether no image takes a further step."""
        return self.stops_fooled and not len(self.active_rows())

    def update(self, point: Point, logits: Tensor, rows: Tensor) -> None:
        """Keep the point of each image whose margin has grown, by the logits (views * b, K) of the
        images `rows`, (b,)."""
        labels = self.labels[rows].repeat(self.views)
        targets = None if self.targets is None else self.targets[rows].repeat(self.views)
        goal = labels if targets is None else targets
        if not self.losses:
            check_classes(goal, logits, 1)
        margins = margin(logits.float(), labels, targets)
        # no answer is a wrong one, and never the target
        undecided_margin = math.inf if targets is None else -math.inf
        margins = torch.where(has_prediction(logits), margins, undecided_margin)
        margins = margins.view(self.views, len(rows)).mean(0)
        if not self.point:
            self.point = point
        better = torch.zeros_like(self.margins, dtype=torch.bool)
        better[rows] = margins > self.margins[rows]
        self.margins = self.margins.index_copy(0, rows, torch.maximum(margins, self.margins[rows]))
        self.point = {name: choose(better, x, self.point[name]) for name, x in point.items()}
        self.losses.append(mean_cross_entropy(logits, goal))
