"""The best point of each image, over the steps and restarts of an attack."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from moireaug.attacks.answers import decided
from moireaug.attacks.checks import check_classes
from moireaug.attacks.losses import margin, reported
from moireaug.attacks.problem import Point
from moireaug.attacks.rules import choose

# margin, in logits, above which an image stops as fooled: rounding differs between batches
SURE = 1e-3


class Best:
    """Keeps each image's point of the greatest margin, over steps and restarts, and the mean loss
    of each step."""

    def __init__(self, labels: Tensor, targets: Tensor | None, views: int) -> None:
        self.labels, self.targets, self.views = labels, targets, views
        self.point: Point = {}
        self.losses: list[Tensor] = []
        # whether fooled images stop, as the model answers the same when asked twice
        self.settled = False
        self.score = torch.full_like(labels, -math.inf, dtype=torch.float32)

    def left(self) -> Tensor:
        """Return the indices of the images that take further steps: all, or, where fooled images
        stop, the others."""
        fooled = (self.score > SURE) & self.settled
        return (~fooled).nonzero()[:, 0]

    @property
    def done(self) -> bool:
        """Whether no image is left to take a step."""
        return self.settled and not len(self.left())

    def watch(self, point: Point, logits: Tensor, rows: Tensor) -> None:
        """Keep what is better than before.

        Args:
            point: of all images. logits: (views * b, K), of the images `rows`. rows: (b,) indices.
        """
        labels = self.labels[rows].repeat(self.views)
        targets = None if self.targets is None else self.targets[rows].repeat(self.views)
        goal = labels if targets is None else targets
        if not self.losses:
            check_classes(goal, logits, 1)
        score = margin(logits.float(), labels, targets)
        # no answer is a wrong one, and never the target
        score = torch.where(decided(logits), score, math.inf if self.targets is None else -math.inf)
        score = score.view(self.views, len(rows)).mean(0)
        if not self.point:
            self.point = point
        better = torch.zeros_like(self.score, dtype=torch.bool)
        better[rows] = score > self.score[rows]
        self.score = self.score.index_copy(0, rows, torch.maximum(score, self.score[rows]))
        self.point = {name: choose(better, x, self.point[name]) for name, x in point.items()}
        self.losses.append(reported(logits, goal))
