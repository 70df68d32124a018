"""A batch of an evaluation as one batch per scene of a mixture, shown and measured in halves where
the device's memory is short."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from moireaug.evaluation.conditions import Condition, EvalBatch
from moireaug.evaluation.judges import Judge
from moireaug.mixed_shot import in_order


@dataclass(frozen=True)
class SceneBatches:
    """One batch per scene, each with the rows (b,) of its images in the whole batch of B images."""

    rows: list[Tensor]
    batches: list[EvalBatch]

    def show(self, condition: Condition) -> Tensor:
        """Return the images of a condition, (B, 3, H, W)."""
        return in_order(self.rows, [show(condition, batch) for batch in self.batches])

    def logits(self, judge: Judge, images: Tensor) -> Tensor:
        """Return a judge's logits (B, K) for the images of a condition."""
        logits = []
        for rows, batch in zip(self.rows, self.batches, strict=True):
            logits.append(judge.logits(batch, images[rows]))
        return in_order(self.rows, logits)

    def measure(self, condition: Condition, images: Tensor) -> dict[str, list[float]]:
        """Return the figures that a condition measures on its images, B values each."""
        figures: dict[str, list[float]] = {}
        for rows, batch in zip(self.rows, self.batches, strict=True):
            for name, values in measure(condition, batch, images[rows]).items():
                figures.setdefault(name, []).extend(values)
        order = torch.cat(self.rows).argsort().tolist()
        return {name: [values[place] for place in order] for name, values in figures.items()}


def show(condition: Condition, batch: EvalBatch) -> Tensor:
    """Show the whole batch at once, or, where it does not fit the device's memory, in halves. The
    halves then draw their random numbers one after the other: not those of the whole batch, but the
    same each time."""
    generators = _generators(batch)
    states = [generator.get_state() for generator in generators]
    try:
        return condition.show(batch)
    except torch.OutOfMemoryError:
        if len(batch.images) == 1:
            raise
    for generator, state in zip(generators, states, strict=True):
        generator.set_state(state)
    torch.cuda.empty_cache()  # outside of the handler, whose traceback keeps the tensors alive
    middle = len(batch.images) // 2
    return torch.cat([show(condition, batch[:middle]), show(condition, batch[middle:])])


def _generators(batch: EvalBatch) -> list[torch.Generator]:
    """Return every generator that a condition may draw from: the batch's, and the global ones of
    the CPU and of the images' device."""
    generators = [batch.generator, torch.default_generator]
    if batch.images.is_cuda:
        generators.append(torch.cuda.default_generators[batch.images.device.index])
    return generators


def measure(condition: Condition, batch: EvalBatch, images: Tensor) -> dict[str, list[float]]:
    """Measure the whole batch at once, or, where it does not fit the device's memory, in halves."""
    try:
        return condition.measure(batch, images)
    except torch.OutOfMemoryError:
        if len(images) == 1:
            raise
    torch.cuda.empty_cache()  # outside of the handler, as in `show`
    middle = len(images) // 2
    first = measure(condition, batch[:middle], images[:middle])
    second = measure(condition, batch[middle:], images[middle:])
    return {name: first[name] + second[name] for name in first}
