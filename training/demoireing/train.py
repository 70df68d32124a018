"""Training of a demoiréing network: begun, resumed, or read back where it is complete."""

import json
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import EMAWeightAveraging

from moireaug.common.files import write_text
from moireaug.defenses import demoire
from moireaug.defenses.demoire import DemoireNet
from training.data.batches import require_even
from training.demoireing.batches import PairBatches
from training.demoireing.module import MAX_GRADIENT_NORM, Demoireing
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig
from training.demoireing.starting import start_as_identity
from training.runs.identity import Origin
from training.runs.run import Run
from training.system.files import read_checkpoint
from training.system.processes import is_first, say
from training.trainer import ranks
from training.trainer.make import OriginRecord, RunCheckpoint, make_trainer


def module_of(cfg: DemoireConfig) -> Demoireing:
    """Return the module that trains a run's network, with the weights that it starts from."""
    network = demoire.build(cfg.model, width=cfg.demoire.width, weights=cfg.weights)
    if cfg.weights is None:
        start_as_identity(network)
    return Demoireing(network, cfg.demoire, cfg.train)


def try_out(run: Run[DemoireConfig]) -> None:
    """Make the network and the trainer once, before any run is moved or any time is spent."""
    module_of(run.config)
    trainer = trainer_of(run.config, run.folder, "")
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
    if resumes and (train := run.training_cost()):
        module.load_state_dict(read_checkpoint(best)["state_dict"])
        say(f"Training is complete: the weights are read from {best}.")
        return network.eval(), train
    history = read_checkpoint(last)["history"] if resumes else []
    millions = sum(weights.numel() for weights in network.parameters()) / 1e6
    say(
        f"Training {cfg.model} of width {cfg.demoire.width:g} ({millions:.2f} million weights) on "
        f"pairs of {cfg.data.name}, target {cfg.demoire.target}: {cfg.train.steps} steps of "
        f"{cfg.train.batch_size}."
    )
    if history:
        say(f"Resuming from {last} after {history[-1]['steps']:.0f} steps.")
    batches = PairBatches(cfg, splits, first_epoch=len(history))
    trainer = trainer_of(cfg, out, splits.files)
    best_checkpoint, wall_seconds = ranks.fit(trainer, module, batches, out)
    train = cost(module.history, cfg.train.batch_size) | {
        "wall_seconds": wall_seconds,
        "best_steps": int(best_checkpoint["history"][-1]["steps"]),
        "weights": round(1e6 * millions),
    }
    if is_first():
        write_text(out / "train.json", json.dumps(train))
    return network.eval(), train


def trainer_of(cfg: DemoireConfig, out: Path, files: str) -> L.Trainer:
    """Return Lightning's trainer, which keeps best.ckpt and last.ckpt in the run's folder, with the
    fingerprint of its files."""
    callbacks = [
        EMAWeightAveraging(decay=cfg.train.ema),
        RunCheckpoint(out, "best", monitor="val_psnr", mode="max"),
        RunCheckpoint(out, "last"),
        OriginRecord(Origin(files)),
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
