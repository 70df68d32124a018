"""Catastrophic overfitting of few-step adversarial training: detected on validation, undone."""

from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import WeightAveraging

from training.classifier.module import Classifier, accuracy_unattacked
from training.system.files import read_checkpoint
from training.system.processes import print_once


class CollapseGuard(L.Callback):
    """Restores the best epoch of a collapsed model, and continues with more steps.

    A model that learns against a few steps may learn to defeat these alone (catastrophic
    overfitting, Wong et al., 2020): within an epoch its accuracy under more steps falls to nothing,
    or attacked images become easier than others.
    The event is printed and kept in the run's history; the schedule of the learning rate continues.
    """

    def __init__(self, best: Path) -> None:
        self.best = best

    def on_train_epoch_end(  # type: ignore[override]
        self, trainer: L.Trainer, module: Classifier
    ) -> None:
        # Before last.ckpt is written, which so holds what is restored: a run that is killed between
        # its two checkpoints resumes with a best.ckpt of a later epoch.
        is_last = trainer.current_epoch + 1 == trainer.max_epochs
        if is_last or not module.collapses(module.history):
            return
        epoch = 1
        if len(module.history) > 1:  # else there is no other epoch
            best = read_checkpoint(self.best)
            restore(trainer, module, best)
            epoch = best["epoch"] + 1
        module.harden(trainer.current_epoch)
        steps = module.adversary.cfg.steps
        _report(module, f"Back to epoch {epoch}, and training continues with {steps} steps.")


def note_late_collapse(module: Classifier, best_epoch: int) -> None:
    """Record a collapse in the last epoch of a training that has ended, also in a process before
    this one, in which Lightning would call no hook."""
    if module.collapses(module.history):
        module.collapsed_at = int(module.history[-1]["epoch"])
        # the only epoch, if it was the first
        _report(module, f"It was the last epoch: epoch {best_epoch + 1} is kept.")


def _report(module: Classifier, consequence: str) -> None:
    last = module.history[-1]
    attacked = f"{last['perturbed']:.0%} of attacked images are right"
    if module.is_masked(last):
        sign = f"{attacked}, and of others only {accuracy_unattacked(last):.0%}"
    else:
        best = max(row["perturbed"] for row in module.history)
        sign = f"{attacked}, after {best:.0%}"
    epoch = int(module.collapsed_at or 0) + 1
    print_once(f"\nCatastrophic overfitting in epoch {epoch}: {sign}. {consequence}")


def restore(trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
    """Restore weights, their average and momentum; epoch, learning rate and draws continue."""
    for callback in trainer.callbacks:  # type: ignore[attr-defined]
        if isinstance(callback, WeightAveraging):  # it restores the weights, too
            callback.on_load_checkpoint(trainer, module, checkpoint)
    for optimizer, state in zip(trainer.optimizers, checkpoint["optimizer_states"], strict=True):
        rates = [(g["lr"], g["momentum"]) for g in optimizer.param_groups]
        optimizer.load_state_dict(state)
        for group, (lr, momentum) in zip(optimizer.param_groups, rates, strict=True):
            group["lr"], group["momentum"] = lr, momentum
