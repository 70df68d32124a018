"""Training of a demoiréing network, from its first weights: begun, resumed, or read back."""

import json
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging
from torch import nn

from moireaug.common.files import write_text
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
from training.runs.metrics import training_cost
from training.runs.run import Run
from training.system.files import read_checkpoint
from training.system.processes import is_first, print_once
from training.trainer import ranks
from training.trainer.make import OriginRecord, RunCheckpoint, make_trainer

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

    Raises:
        ValueError: a checkpoint that is missing or damaged, or pictures that cannot be used.
        ConnectionError: another process of this run was lost.
        FloatingPointError: the loss became nan or infinite.
        OSError: a disk that is full or not writable.
        KeyboardInterrupt: Ctrl-C or SIGTERM; what was validated is kept.
    """
    cfg = run.config
    L.seed_everything(cfg.seed, verbose=False)
    out, resumes = run.folder, run.can_resume()
    last, best = out / "last.ckpt", out / "best.ckpt"
    module = module_of(cfg)
    network = module.network
    if is_first():
        run.write_settings()
    if resumes and (train := training_cost(out)):
        module.load_state_dict(read_checkpoint(best)["state_dict"])
        print_once(f"Training is complete: the weights are read from {best}.")
        return network.eval(), train
    history = read_checkpoint(last)["history"] if resumes else []
    millions = sum(weights.numel() for weights in network.parameters()) / 1e6
    print_once(
        f"Training {cfg.model} of width {cfg.demoire.width:g} ({millions:.2f} million weights) on "
        f"pairs of {cfg.data.name}, target {cfg.demoire.target}: {cfg.train.steps} steps of "
        f"{cfg.train.batch_size}."
    )
    if history:
        print_once(f"Resuming from {last} after {history[-1]['steps']:.0f} steps.")
    batches = PairBatches(cfg, splits, first_epoch=len(history))
    trainer = trainer_of(cfg, out, Origin.of(cfg.weights, splits.files))
    best_checkpoint, wall_seconds = ranks.fit(trainer, module, batches, out)
    train = cost(module.history, cfg.train.batch_size) | {
        "wall_seconds": wall_seconds,
        "best_steps": int(best_checkpoint["history"][-1]["steps"]),
        "weights": round(1e6 * millions),
    }
    if is_first():
        write_text(out / "train.json", json.dumps(train))
    return network.eval(), train


def trainer_of(cfg: DemoireConfig, out: Path, origin: Origin) -> L.Trainer:
    """Return Lightning's trainer, which keeps best.ckpt and last.ckpt in the run's folder, with its
    origin."""
    callbacks = [
        EMAWeightAveraging(decay=cfg.train.ema),
        RunCheckpoint(out, "best", monitor="val_psnr", mode="max"),
        RunCheckpoint(out, "last"),
        OriginRecord(origin),
    ]
    epochs = cfg.train.steps // cfg.train.check_every
    return make_trainer(cfg.trainer, epochs, callbacks, MAX_GRADIENT_NORM)


def cost(history: list[dict[str, float]], batch_size: int) -> dict[str, Any]:
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
