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


class Best:
    """Keeps each image's point of the greatest margin, over steps and restarts, and the mean loss
    of each step."""

    def __init__(self, labels: Tensor, targets: Tensor | None, views: int) -> None:
        self.labels, self.targets, self.views = labels, targets, views
        self.point: Point = {}
        self.losses: list[Tensor] = []

    def watch(self, point: Point, logits: Tensor) -> None:
        labels = self.labels.repeat(self.views)
        targets = None if self.targets is None else self.targets.repeat(self.views)
        goal = labels if targets is None else targets
        if not self.losses:
            check_classes(goal, logits, 1)
        score = margin(logits.float(), labels, targets)
        # no answer is a wrong one, and never the target
        score = torch.where(decided(logits), score, math.inf if self.targets is None else -math.inf)
        score = score.view(self.views, len(self.labels)).mean(0)
        if not self.point:
            self.point, self.score = point, torch.full_like(score, -math.inf)
        better = score > self.score
        self.score = torch.where(better, score, self.score)
        self.point = {name: choose(better, x, self.point[name]) for name, x in point.items()}
        self.losses.append(reported(logits, goal))
