"""Defaults that depend on what training starts from: random weights, or given ones."""

from __future__ import annotations

from typing import NamedTuple

import torch
from lightning.pytorch.callbacks import EMAWeightAveraging, WeightAveraging
from torch import Tensor

from training.schema import Train

SCRATCH_LR = 0.1
FINE_LR = 0.002  # of a batch of 128
EMA = 0.98
CLIP = 1.0  # norm of a fine-tuning step's gradient: any network's, also one without normalisation


class Tuning(NamedTuple):
    """How the weights are updated.

    Args:
        lr: the peak learning rate of the schedule. clip: bound of the gradient's norm, or None.
        ema: decay of the averaged weights a step.
        rising: whether the decay rises from zero over the first steps.
    """

    lr: float
    clip: float | None
    ema: float
    rising: bool


def tuning(train: Train, *, fine: bool) -> Tuning:
    """Return the tuning for `train.lr` and `train.ema`; null is replaced by these defaults.

    From scratch: lr 0.1, ema 0.98. Fine-tuning: lr 0.002 for a batch of 128, in proportion to the
    batch; gradients clipped to norm 1; and an average whose decay rises to 0.98, so that it follows
    even a few steps.

    Args:
        fine: whether training starts from given weights.
    """
    lr, ema = SCRATCH_LR, EMA
    if fine:
        lr = FINE_LR * train.batch_size / 128
    if train.lr is not None:
        lr = train.lr
    if train.ema is not None:
        ema = train.ema
    return Tuning(lr=lr, clip=CLIP if fine else None, ema=ema, rising=fine and train.ema is None)


def averaging(chosen: Tuning) -> WeightAveraging:
    """Return the callback that averages the weights."""
    if not chosen.rising:
        return EMAWeightAveraging(decay=chosen.ema)

    def average(kept: Tensor, new: Tensor, n: Tensor) -> Tensor:
        decay = torch.clamp((1 + n) / (10 + n), max=chosen.ema)
        return decay * kept + (1 - decay) * new

    return WeightAveraging(avg_fn=average)
