"""Defaults of training that depend on its start: random weights, or given ones."""

from collections.abc import Iterable
from typing import NamedTuple

import torch
from lightning.pytorch.callbacks import EMAWeightAveraging, WeightAveraging
from torch import Tensor, nn

from training.classifier.muon import Muon
from training.config.schema import Train

SCRATCH_LR, SCRATCH_DECAY = 0.02, 0.05  # of Muon
FINE_LR, FINE_DECAY = 0.002, 5e-4  # of SGD and a batch of 128
EMA = 0.98
CLIP = 1.0  # norm of a fine-tuning step's gradient: any network's, also one without normalisation


class Tuning(NamedTuple):
    """How the weights are updated.

    Args:
        fine: whether the weights of `weights=` are fine-tuned: then by SGD, else by Muon.
        clip: bound of the gradient's norm; None for none.
        ema: decay per step of the averaged weights.
        rising: whether that decay rises from zero over the first steps.
    """

    fine: bool
    lr: float
    weight_decay: float
    clip: float | None
    ema: float
    rising: bool


def tuning_of(train: Train, *, fine: bool) -> Tuning:
    """Return the tuning for these settings; null is replaced by defaults.

    From scratch: Muon, lr 0.02, weight decay 0.05, ema 0.98. Fine-tuning: SGD, lr 0.002 for a batch
    of 128, in proportion to the batch, weight decay 5e-4; gradients clipped to norm 1; and an
    average whose decay rises to 0.98, so that it follows even a few steps."""
    lr, weight_decay, ema = SCRATCH_LR, SCRATCH_DECAY, EMA
    if fine:
        lr, weight_decay = FINE_LR * train.batch_size / 128, FINE_DECAY
    if train.lr is not None:
        lr = train.lr
    if train.weight_decay is not None:
        weight_decay = train.weight_decay
    if train.ema is not None:
        ema = train.ema
    return Tuning(
        fine=fine,
        lr=lr,
        weight_decay=weight_decay,
        clip=CLIP if fine else None,
        ema=ema,
        rising=fine and train.ema is None,
    )


def freeze_but_first(model: nn.Module, share: float) -> None:
    """Freeze the weights of all but a share of a model's layers, counted from the image on.

    Moiré is told from a picture by details of a few pixels, which the first layers see; what the
    others make of them can stay."""
    layers = []
    for module in model.modules():
        if any(True for _ in module.parameters(recurse=False)):
            layers.append(module)
    for layer in layers[max(1, int(share * len(layers))) :]:
        for weight in layer.parameters(recurse=False):
            weight.requires_grad_(False)


def make_optimizer(
    params: Iterable[nn.Parameter], tuning: Tuning, momentum: float
) -> torch.optim.Optimizer:
    """Return the optimizer of a model's parameters."""
    if not tuning.fine:
        return Muon(params, tuning.lr, momentum, tuning.weight_decay)
    return torch.optim.SGD(
        params,
        tuning.lr,
        momentum=momentum,
        weight_decay=tuning.weight_decay,
        nesterov=momentum > 0,
    )


def weight_averaging(tuning: Tuning) -> WeightAveraging:
    """Return the callback that averages the weights."""
    if not tuning.rising:
        return EMAWeightAveraging(decay=tuning.ema)

    def average(mean: Tensor, new: Tensor, n: Tensor) -> Tensor:
        decay = torch.clamp((1 + n) / (10 + n), max=tuning.ema)
        return decay * mean + (1 - decay) * new

    return WeightAveraging(avg_fn=average)
