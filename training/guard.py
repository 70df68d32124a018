"""Catastrophic overfitting of few-step adversarial training: detected on validation, undone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import WeightAveraging
from lightning.pytorch.utilities import rank_zero_only

from training.classifier import Classifier
from training.files import read_checkpoint

FLOOR = 0.2  # accuracy below which a model has nothing to lose yet
FALL = 0.5  # share of the best accuracy that counts as a collapse


def collapsed(perturbed: list[float]) -> bool:
    """Return whether accuracy in the last epoch has fallen below half of the best before it.

    Args:
        perturbed: accuracy of each epoch under an attack of at least three steps, in [0, 1].
    """
    *before, now = perturbed
    return bool(before) and max(before) > FLOOR and now < FALL * max(before)


class Guard(L.Callback):
    """Restores the best epoch of a collapsed model, and continues with three steps.

    A model that learns against one step may learn to defeat that step alone (catastrophic
    overfitting, Wong et al., 2020): within an epoch its accuracy under more steps falls to nothing.
    The event is printed and kept in the run's history; the schedule of the learning rate continues.

    Args:
        best: the best checkpoint's file.
    """

    def __init__(self, best: Path) -> None:
        self.best = best

    def on_train_epoch_start(  # type: ignore[override]
        self, trainer: L.Trainer, module: Classifier
    ) -> None:
        history = [h["perturbed"] for h in module.history if "perturbed" in h]
        if module.hardened or not module.few_steps or not history or not collapsed(history):
            return
        good = read_checkpoint(self.best)
        restore(trainer, module, good)
        module.harden(int(module.history[-1]["epoch"]))
        rank_zero_only(print)(
            f"\nCatastrophic overfitting in epoch {module.collapsed_at}: accuracy under three "
            f"steps fell to {history[-1]:.0%} from {max(history):.0%}. "
            f"Back to epoch {good['epoch']}, and training continues with three steps."
        )


def restore(trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
    """Restore weights, their average and momentum; epoch, learning rate and draws continue."""
    module.load_state_dict(checkpoint["state_dict"])
    for callback in trainer.callbacks:  # type: ignore[attr-defined]
        if isinstance(callback, WeightAveraging):
            callback.on_load_checkpoint(trainer, module, checkpoint)
    for optimizer, state in zip(trainer.optimizers, checkpoint["optimizer_states"], strict=True):
        rates = [(g["lr"], g["momentum"]) for g in optimizer.param_groups]
        optimizer.load_state_dict(state)
        for group, (lr, momentum) in zip(optimizer.param_groups, rates, strict=True):
            group["lr"], group["momentum"] = lr, momentum
