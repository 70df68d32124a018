"""Classifiers: the models that classify the images of a condition, in parts where a batch does not
fit the device's memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from moireaug.attacks import predicted
from moireaug.attacks.checks import check_classes
from moireaug.attacks.model import logits_without_gradient
from moireaug.common.networks import is_randomised, rejects_of
from moireaug.defenses import Defended, restore_mean
from moireaug.evaluation.conditions import EvalBatch, ImageTransform, Model
from moireaug.evaluation.identity import identity_of

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
        self.randomised = is_randomised(model)

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


def within_memory(compute: Callable[..., T], batch: EvalBatch, *shown: Tensor) -> T:
    """Return what `compute` makes of a batch and of what its images are shown as; where that does
    not fit the device's memory, with models and defences that take its images in halves, in
    quarters and so on. Random numbers are still drawn for the whole batch, so that no figure
    depends on the memory, unless the model itself is randomised, or a defence is made of several
    that are.

    Raises:
        torch.OutOfMemoryError: not even single images fit, or it is neither model nor defence that
            is too large.
    """
    generators = _generators(batch)
    states = [generator.get_state() for generator in generators]
    size = len(batch.images)
    while True:
        try:
            return compute(batch, *shown)
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


DEFENCE_DRAWS = 20  # of a randomised defence, as many as AutoAttack's version "rand" averages over


@dataclass(frozen=True)
class Classifier:
    """The attacked model, the same behind a defence, or another model.

    Args:
        name: name of the classifier within an evaluation.
        defence: defence in front of the model.
        model: another model than the attacked one, for transfer.
        restores_mean: whether the mean of the clean image, which only an experimenter knows, is
            restored first.
        draws: number of draws of a randomised defence, over which an answer, and an attack that
            knows of it, take the probabilities' mean, see `Defended`. A model that is random itself
            is asked once; evaluate `Defended(model, Compose(()), draws=20)` instead.
    """

    name: str
    defence: ImageTransform | None = None
    model: Model | None = field(default=None, repr=False)
    restores_mean: bool = False
    draws: int = 1

    @cached_property
    def base(self) -> Classifier:
        """The one without its defence; success counts the images that it gets right clean."""
        if self.model is None:
            return UNDEFENDED
        if self.defence is None and not self.restores_mean:
            return self
        return Classifier(f"{self.name}, undefended", model=self.model)

    def defended(self, model: Model, max_images: int | None) -> Model:
        """Return a model behind the classifier's defence, where each takes `max_images` at once."""
        model = in_parts(model, max_images)
        if self.defence is None:
            return model
        return Defended(model, in_parts(self.defence, max_images), draws=self.draws)

    def predictions(self, batch: EvalBatch, images: Tensor) -> Tensor:
        """Return the predicted classes (B,) of shown images; every model's state is restored.

        Raises:
            ValueError: logits that cannot be read, or have no class of a label.
        """
        if self.restores_mean:
            images = restore_mean(images, batch.images)
        attacked = batch.model if self.model is None else self.model
        model = self.defended(attacked, batch.max_images)
        logits = logits_without_gradient(model, images)
        rejects = rejects_of(model)
        check_classes(batch.labels, logits, rejects=rejects)
        return predicted(logits, rejects=rejects)

    @cached_property
    def identity(self) -> str:
        """The identity in records: the name, those of defence and model, whether the mean is
        restored, and the number of draws."""
        parts = [self.name]
        for name, part in (("defence", self.defence), ("model", self.model)):
            if part is not None:
                parts.append(f"{name} {identity_of(part)}")
        if self.restores_mean:
            parts.append("restores mean")
        if self.draws > 1:
            parts.append(f"draws {self.draws}")
        return "#".join(parts)


UNDEFENDED = Classifier("model")


def averaging_classifier(name: str, defence: ImageTransform) -> Classifier:
    """Return the attacked model behind a defence, by the mean of many draws where it is randomised:
    of single draws, a worst case over several conditions would pick the unlucky ones."""
    if not is_randomised(defence):
        return Classifier(name, defence)
    return Classifier(f"{name}_{DEFENCE_DRAWS}_draws", defence, draws=DEFENCE_DRAWS)
