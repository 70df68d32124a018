"""A batch shown and measured in halves where the device's memory is short."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.evaluation.conditions import Condition, EvalBatch


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
