"""Judges: the models that classify the images of a condition."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from moireaug.attacks import evaluating
from moireaug.defenses import Compose, restore_mean
from moireaug.evaluation.conditions import Defence, EvalBatch, Model
from moireaug.evaluation.identity import identity
from moireaug.networks import in_evaluation_mode


@dataclass(frozen=True)
class Judge:
    """The attacked model, the same behind a defence, or another model.

    Args:
        name: name of the judge within an evaluation.
        defence: defence in front of the model.
        model: another model than the attacked one, for transfer.
        restores_mean: whether the mean of the clean image, which only an experimenter knows, is
            restored first.
    """

    name: str
    defence: Defence | None = None
    model: Model | None = None
    restores_mean: bool = False

    @cached_property
    def base(self) -> Judge:
        """The judge without its defence; success counts the images that it gets right clean."""
        if self.model is None:
            return UNDEFENDED
        if self.defence is None and not self.restores_mean:
            return self
        return Judge(f"{self.name}, undefended", model=self.model)

    def logits(self, batch: EvalBatch, images: Tensor) -> Tensor:
        """Return the logits (B, K) of shown images; every model's state is restored."""
        if self.restores_mean:
            images = restore_mean(images, batch.images)
        model = batch.model if self.model is None else self.model
        defence = Compose(() if self.defence is None else (self.defence,))
        with in_evaluation_mode(defence), evaluating(model, images), torch.no_grad():
            # either may work in place
            return model(defence(images.clone()).clone())

    @cached_property
    def identity(self) -> str:
        """The judge's identity in records: its name, and those of its defence and model."""
        parts = [self.name]
        for name, part in (("defence", self.defence), ("model", self.model)):
            if part is not None:
                parts.append(f"{name} {identity(part)}")
        return "#".join(parts)


UNDEFENDED = Judge("model")
