"""Training of a demoiréing network: its first weights, its trainer and its cost."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging
from torch import nn

from moireaug.defenses import demoire
from moireaug.defenses.demoire import DemoireNet
from moireaug.defenses.demoire.amnet import AMNet
from moireaug.defenses.demoire.esdnet import DenseBlock, ESDNet
from training.data.batches import require_even
from training.demoireing.batches import PairBatches
from training.demoireing.module import MAX_GRADIENT_NORM, Demoireing
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig
from training.runs.identity import Origin
from training.runs.run import Run
from training.trainer.make import make_trainer
from training.trainer.train import train

PLANES = 12  # of half size, which make up an image


def module_of(cfg: DemoireConfig) -> Demoireing:
    """Return the module that trains a run's network, with the weights that it starts from."""
    network = demoire.build(cfg.model, width=cfg.demoire.width, weights=cfg.weights)
    if cfg.weights is None:
        start_as_identity(network)
    return Demoireing(network, cfg.demoire, cfg.train)


def try_out(run: Run[DemoireConfig]) -> None:
    """Make the network and the trainer once, before any run is moved or any time is spent."""
    module_of(run.config)
    trainer = trainer_of(run.config, run.folder, Origin())
    require_even(run.config.train.batch_size, trainer.world_size)


def train_network(run: Run[DemoireConfig], splits: Splits) -> tuple[DemoireNet, dict[str, Any]]:
    """Train, and return the averaged weights that did best on validation, and the cost.

    Raises: as `training.trainer.train.train`.
    """
    cfg = run.config
    L.seed_everything(cfg.seed, verbose=False)
    module = module_of(cfg)
    weights = sum(weights.numel() for weights in module.network.parameters())
    plan = (
        f"Training {cfg.model} of width {cfg.demoire.width:g} ({weights / 1e6:.2f} million "
        f"weights) on pairs of {cfg.data.name}, target {cfg.demoire.target}: {cfg.train.steps} "
        f"steps of {cfg.train.batch_size}."
    )
    trainer = trainer_of(cfg, run.folder, Origin.of(cfg.weights, splits))

    def finish(best: Mapping[str, Any], seconds: float) -> dict[str, Any]:
        best_steps = int(best["history"][-1]["steps"])
        facts = {"wall_seconds": seconds, "best_steps": best_steps, "weights": weights}
        return cost_of(module.history, cfg.train.batch_size) | facts

    batches_from = partial(PairBatches, cfg, splits)
    cost = train(run, module, trainer, batches_from, finish, plan)
    return module.network.eval(), cost


def trainer_of(cfg: DemoireConfig, folder: Path, origin: Origin) -> L.Trainer:
    """Return Lightning's trainer of a demoiréing network in a run's folder."""
    averaging = EMAWeightAveraging(decay=cfg.train.ema)
    epochs = cfg.train.steps // cfg.train.check_every
    return make_trainer(
        cfg.trainer, epochs, folder, origin, "val_psnr", [averaging], MAX_GRADIENT_NORM
    )


def cost_of(history: list[dict[str, float]], batch_size: int) -> dict[str, Any]:
    """Return the history of a training, and its time without validation."""
    seconds = sum(h["seconds"] for h in history)
    steps = int(history[-1]["steps"])
    return {
        "seconds": seconds,
        "steps": steps,
        "pairs_per_second": steps * batch_size / max(seconds, 1e-9),
        "history": history,
    }


@torch.no_grad()
def start_as_identity(network: DemoireNet) -> bool:
    """Change the fresh weights of an ESDNet or AMNet so that it predicts the image itself.

    In an ESDNet, twelve channels of each level pass the planes of half size that make up the image
    at its scale, and no block adds anything yet; all other weights stay as they were drawn. AMNet's
    last convolutions are zero. The other networks add what they predict to the image.

    Returns:
        Whether anything was changed: not in another network, nor in an ESDNet below width 0.25,
        where there are fewer than twelve channels.
    """
    if isinstance(network, AMNet):
        for last in (network.additive, network.multiplicative):
            _silence(last)
        return True
    return isinstance(network, ESDNet) and _pass_images(network)


def _pass_images(network: ESDNet) -> bool:
    """Start an ESDNet as the identity, if it has enough channels; return whether it has."""
    passing = [_convolution(network.head)]
    for module in (*network.merges, *network.tails):
        passing.append(_convolution(module))
    if any(min(conv.weight.shape[:2]) < PLANES for conv in passing):
        return False
    for level in (*network.encoders, *network.decoders):
        for block in level.modules():
            if isinstance(block, DenseBlock):
                _silence(block.fuse)
    for conv in passing:
        _pass(conv)
    for module in network.downs:
        _halve(_convolution(module))
    return True


def _silence(conv: nn.Conv2d) -> None:
    """Make a convolution return zero."""
    for weights in conv.parameters():
        nn.init.zeros_(weights)


def _pass(conv: nn.Conv2d) -> None:
    """Make a convolution pass its first twelve channels."""
    centre = conv.kernel_size[0] // 2
    conv.weight[:PLANES] = 0
    conv.weight[range(PLANES), range(PLANES), centre, centre] = 1
    conv.bias[:PLANES] = 0  # type: ignore[index]


def _halve(conv: nn.Conv2d) -> None:
    """Make a 3 x 3 convolution of stride 2 turn the planes of an image into those of the image at
    half size: the mean of a colour's four planes is a pixel there."""
    conv.weight[:PLANES] = 0
    conv.bias[:PLANES] = 0  # type: ignore[index]
    for plane in range(PLANES):
        colour, place = divmod(plane, 4)
        down, right = divmod(place, 2)
        conv.weight[plane, 4 * colour : 4 * colour + 4, 1 + down, 1 + right] = 0.25


def _convolution(module: nn.Module) -> nn.Conv2d:
    """Return the first convolution in a module."""
    return next(layer for layer in module.modules() if isinstance(layer, nn.Conv2d))
