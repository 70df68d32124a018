"""Defaults of training that depend on what it starts from: random weights, or given ones that are fine-tuned."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from lightning.pytorch.callbacks import EMAWeightAveraging, WeightAveraging
from torch import Tensor

SCRATCH_LR = 0.1
FINE_LR = 0.002  # of a batch of 128
EMA = 0.98
CLIP = 1.0  # norm of a fine-tuning step's gradient: any network's, also one without normalisation


class Tuning(NamedTuple):
    """How the weights move.

    Args:
        lr: the greatest learning rate of the schedule. clip: bound of the gradient's norm, or None.
        ema: decay of the averaged weights a step. rising: whether it rises to that from nothing over the first steps.
    """

    lr: float
    clip: float | None
    ema: float
    rising: bool


def tuning(cfg: Any) -> Tuning:
    """Return the settings that `train.lr` and `train.ema` stand for; null is chosen here.

    From scratch: lr 0.1, ema 0.98. Fine-tuning (`weights` are given): lr 0.002 for a batch of 128, in proportion to the
    batch; gradients clipped to norm 1; and an average whose decay rises to 0.98, so that it follows even a few steps.
    """
    fine, t = cfg.weights is not None, cfg.train
    lr = FINE_LR * t.batch_size / 128 if fine else SCRATCH_LR
    return Tuning(
        lr=lr if t.lr is None else t.lr,
        clip=CLIP if fine else None,
        ema=EMA if t.ema is None else t.ema,
        rising=fine and t.ema is None,
    )


def averaging(chosen: Tuning) -> WeightAveraging:
    """Return the callback that averages the weights."""
    if not chosen.rising:
        return EMAWeightAveraging(decay=chosen.ema)

    def average(kept: Tensor, new: Tensor, n: Tensor) -> Tensor:
        decay = torch.clamp((1 + n) / (10 + n), max=chosen.ema)
        return decay * kept + (1 - decay) * new

    return WeightAveraging(avg_fn=average)
