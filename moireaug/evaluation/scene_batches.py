"""A batch of an evaluation as one batch per scene of a mixture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from moireaug.evaluation.classifiers import Classifier
from moireaug.evaluation.conditions import Condition, EvalBatch
from moireaug.evaluation.memory import within_memory
from moireaug.scene.mixed_shot import join_rows


@dataclass(frozen=True)
class SceneBatches:
    """One batch per scene, each with the rows (b,) of its images in the whole batch of B images."""

    rows: list[Tensor]
    batches: list[EvalBatch]

    def show(self, condition: Condition) -> Tensor:
        """Return the images of a condition, (B, 3, H, W)."""
        images = [within_memory(condition.show, batch) for batch in self.batches]
        return join_rows(self.rows, images)

    def predictions(self, classifier: Classifier, images: Tensor) -> Tensor:
        """Return a classifier's predicted classes (B,) of the images of a condition."""
        classes = []
        for rows, batch in zip(self.rows, self.batches, strict=True):
            predict = partial(classifier.predictions, images=images[rows])
            classes.append(within_memory(predict, batch))
        return join_rows(self.rows, classes)

    def measure(self, condition: Condition, images: Tensor) -> dict[str, list[float]]:
        """Return the figures that a condition measures on its images, B values each."""
        figures: dict[str, list[float]] = {}
        for rows, batch in zip(self.rows, self.batches, strict=True):
            measure = partial(condition.measure, images=images[rows])
            for name, values in within_memory(measure, batch).items():
                figures.setdefault(name, []).extend(values)
        order = torch.cat(self.rows).argsort().tolist()
        return {name: [values[place] for place in order] for name, values in figures.items()}
