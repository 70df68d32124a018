"""A batch that does not fit the device's memory: models and defences take it in parts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from moireaug.common.networks import rejects_of
from moireaug.evaluation.conditions import EvalBatch, Model

T = TypeVar("T")


class InParts(nn.Module):
    """A model or defence that takes a batch in parts and holds one part's activations at a time:
    the backward pass computes them again.

    Args:
        model: (B, 3, H, W) images to logits (B, K), or to images.
        size: images of a part.
    """

    def __init__(self, model: Model, size: int) -> None:
        super().__init__()
        self.model = model
        self.size = size
        self.rejects = rejects_of(model)
        self.randomised = getattr(model, "randomised", False)

    def forward(self, images: Tensor) -> Tensor:
        outputs = []
        for part in images.split(self.size):
            outputs.append(checkpoint(self._output, part, use_reentrant=False))
        return torch.cat(outputs)

    def _output(self, images: Tensor) -> Tensor:
        return self.model(images.clone())  # it may work in place


def in_parts(model: Model, size: int | None) -> Model:
    """Return a model or defence that takes at most `size` images at once; None is the batch."""
    return model if size is None else InParts(model, size)


def within_memory(compute: Callable[[EvalBatch], T], batch: EvalBatch) -> T:
    """Return what `compute` makes of a batch; where that does not fit the device's memory, with
    models and defences that take its images in halves, in quarters and so on. Random numbers are
    still drawn for the whole batch, so that no figure depends on the memory, unless the model
    itself is randomised, or a defence is made of several that are.

    Raises:
        torch.OutOfMemoryError: not even single images fit, or it is neither model nor defence that
            is too large.
    """
    generators = _generators(batch)
    states = [generator.get_state() for generator in generators]
    size = len(batch.images)
    while True:
        try:
            return compute(batch)
        except torch.OutOfMemoryError as error:
            if size <= 1:
                error.add_note(f"The batch has {len(batch.images)} images: pass smaller batches.")
                raise
        for generator, state in zip(generators, states, strict=True):
            generator.set_state(state)
        if batch.images.is_cuda:  # outside of the handler, whose traceback keeps the tensors alive
            torch.cuda.empty_cache()
        size = -(-size // 2)
        batch = dataclasses.replace(batch, max_images=size)


def _generators(batch: EvalBatch) -> list[torch.Generator]:
    """Return every generator that a condition may draw from: the batch's, and the global ones of
    the CPU and of the images' device."""
    generators = [batch.generator, torch.default_generator]
    if batch.images.is_cuda:
        generators.append(torch.cuda.default_generators[batch.images.device.index])
    return generators
