"""Lightning's trainer, with what is the same for every run."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import TQDMProgressBar
from lightning.pytorch.plugins.environments import SLURMEnvironment, TorchElasticEnvironment

from training.checkpoints import AtomicCheckpointIO
from training.schema import Trainer


def make_trainer(settings: Trainer, epochs: int, callbacks: Sequence[L.Callback]) -> L.Trainer:
    """Return a trainer that writes checkpoints whole or not at all, and shows a bar.

    Args:
        settings: passed on as they are. callbacks: what keeps and averages the weights.
    """
    given = asdict(settings)
    if given["accelerator"] == "auto" and not torch.cuda.is_available():
        given["accelerator"] = "cpu"  # Apple's GPUs have no float64, which the geometry needs
    plugins: list[Any] = [AtomicCheckpointIO()]
    if SLURMEnvironment.detect() and not TorchElasticEnvironment.detect():
        plugins.append(SLURMEnvironment(auto_requeue=False))  # the same command resumes by itself
    return L.Trainer(
        **given,
        max_epochs=epochs,
        callbacks=[*callbacks, TQDMProgressBar(leave=False)],
        plugins=plugins,
        logger=False,
        num_sanity_val_steps=0,
        enable_model_summary=False,
        use_distributed_sampler=False,
        benchmark=False,
    )


def quiet() -> None:
    """Silence what Lightning says at every start and a user of these recipes cannot act on."""
    for name in ("lightning.pytorch", "lightning.fabric", "lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", ".*does not have many workers.*")
    warnings.filterwarnings(
        "ignore", ".*in eval mode at the start of training.*"
    )  # what fine-tuning keeps
    warnings.filterwarnings("ignore", ".*Checkpoint directory .* exists and is not empty.*")
    warnings.filterwarnings(
        "ignore", ".*sync_dist=True.*"
    )  # what is logged is the mean of all devices already
    warnings.filterwarnings("ignore", ".*smaller than the logging interval.*")
    warnings.filterwarnings(
        "ignore", ".*isinstance.treespec, LeafSpec.*"
    )  # Lightning's own, on newer torch
