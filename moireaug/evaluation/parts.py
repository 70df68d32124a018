"""A batch of an evaluation in parts: one for each scene of a mixture, and in halves where the
device's memory is short."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from moireaug.evaluation.conditions import Condition, EvalBatch
from moireaug.mixed_shot import in_order

Part = tuple[Tensor, EvalBatch]  # (b,) its rows in the batch, and its images


def joined(parts: Sequence[Part], f: Callable[[Tensor, EvalBatch], Tensor]) -> Tensor:
    """Return f(rows, part) of every part, (b, ...), in the order of the batch."""
    return in_order([rows for rows, _ in parts], [f(rows, part) for rows, part in parts])


def measured(condition: Condition, parts: Sequence[Part], shown: Tensor) -> dict[str, list[float]]:
    """Measure every part; returns each figure's values in the order of the batch."""
    order = torch.cat([rows for rows, _ in parts]).argsort().tolist()
    found: dict[str, list[float]] = {}
    for rows, part in parts:
        for name, values in _measured(condition, part, shown[rows]).items():
            found.setdefault(name, []).extend(values)
    return {name: [values[place] for place in order] for name, values in found.items()}


def shown_of(condition: Condition, batch: EvalBatch) -> Tensor:
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
    halves = [shown_of(condition, batch[:middle]), shown_of(condition, batch[middle:])]
    return torch.cat(halves)


def _generators(batch: EvalBatch) -> list[torch.Generator]:
    """Return all that a condition may draw from: the batch's generator, and the global ones of the
    CPU and of the images' device."""
    found = [batch.generator, torch.default_generator]
    if batch.images.is_cuda:
        found.append(torch.cuda.default_generators[batch.images.device.index])
    return found


def _measured(condition: Condition, batch: EvalBatch, shown: Tensor) -> dict[str, list[float]]:
    """Measure the whole batch at once, or, where it does not fit the device's memory, in halves."""
    try:
        return condition.measure(batch, shown)
    except torch.OutOfMemoryError:
        if len(shown) == 1:
            raise
    torch.cuda.empty_cache()  # outside of the handler, as in `shown_of`
    middle = len(shown) // 2
    first = _measured(condition, batch[:middle], shown[:middle])
    second = _measured(condition, batch[middle:], shown[middle:])
    return {name: first[name] + second[name] for name in first}
