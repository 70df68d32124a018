"""Lightning's trainer, with what is the same for every run."""

from __future__ import annotations

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
