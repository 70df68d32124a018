"""Judges: who looks at what a condition shows."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from moireaug.defenses import restore_mean
from moireaug.evaluation.attackers import Defence
from moireaug.evaluation.conditions import EvalBatch, Model


@dataclass(frozen=True)
class Judge:
    """The attacked model, the same behind a defence, or another model.

    Args:
        name: stands for the judge in records.
        defence: what the images pass before the model.
        model: another model than the attacked one: transfer.
        restores_mean: whether the mean of the clean image, which only an experimenter knows, is
            restored before.
    """

    name: str
    defence: Defence | None = None
    model: Model | None = None
    restores_mean: bool = False

    @property
    def base(self) -> str:
        """The judge without its defence: success counts the images that it has right when clean."""
        return UNDEFENDED.name if self.model is None else self.name

    def logits(self, batch: EvalBatch, shown: Tensor) -> Tensor:
        """Return the answers to what is shown."""
        if self.restores_mean:
            shown = restore_mean(shown, batch.images)
        if self.defence is not None:
            shown = self.defence(shown)
        model = batch.model if self.model is None else self.model
        return model(shown)


UNDEFENDED = Judge("model")


def another(title: str, model: Model) -> Judge:
    """Return another model as a judge. Its name changes with its weights."""
    return Judge(f"{title}#{digest(model) if isinstance(model, nn.Module) else ''}", model=model)


def behind(name: str, defence: Defence) -> Judge:
    """Return the attacked model behind a defence. The judge's name changes with what the defence
    has learned."""
    learned = [part for part in getattr(defence, "networks", ()) if isinstance(part, nn.Module)]
    if isinstance(defence, nn.Module):
        learned.append(defence)
    bank = getattr(defence, "bank", None)
    if bank is not None:
        name += f"#{hashlib.sha256(bank.numpy().tobytes()).hexdigest()[:16]}"
    for network in learned:
        name += f"#{digest(network)}"
    return Judge(name, defence=defence)


def digest(model: nn.Module) -> str:
    """Return sixteen hex digits that change with any weight."""
    sums = hashlib.sha256()
    for name, value in model.state_dict().items():
        sums.update(name.encode())
        sums.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy())
    return sums.hexdigest()[:16]
