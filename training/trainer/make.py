"""Lightning's trainer, with the settings and the checkpoints that all runs share."""

import logging
import signal
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import lightning as L
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch.callbacks import Checkpoint, ModelCheckpoint, TQDMProgressBar
from lightning.pytorch.plugins.environments import SLURMEnvironment, TorchElasticEnvironment
from lightning.pytorch.utilities import rank_zero_only

from moireaug.common.weights import write_tensors
from training.config.schema import Trainer
from training.runs.identity import Origin
from training.runs.layout import BEST, LAST
from training.system import machine
from training.system.messages import terminate

# Lightning's warnings at every start that a user of these recipes cannot act on
KNOWN_WARNINGS = (
    ".*does not have many workers.*",
    ".*in eval mode at the start of training.*",  # batch normalisation in fine-tuning
    ".*Checkpoint directory .* exists and is not empty.*",
    ".*sync_dist=True.*",  # what is logged is the mean of all devices already
    ".*smaller than the logging interval.*",
    ".*isinstance.treespec, LeafSpec.*",  # Lightning's own, on newer torch
)


class EndOnSigterm(L.Callback):
    """Ends training on SIGTERM as on Ctrl-C.

    Lightning's own handler broadcasts the signal, in the middle of what the processes are sending:
    they would wait for each other for ever."""

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        signal.signal(signal.SIGTERM, terminate)


class EpochLines(Checkpoint):
    """Prints a line per epoch, with the figures that a progress bar shows.

    Lightning calls what it takes for a checkpoint last, in the order given: an epoch whose line is
    printed has been kept."""

    @rank_zero_only
    def on_train_epoch_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        figures = []
        history: Any = module.history
        means = history[-1] if history else {}  # the bar's loss is that of the last batch
        for name, value in trainer.progress_bar_metrics.items():
            figures.append(f"{name} {means.get(name, value):.4g}")
        print(f"Epoch {trainer.current_epoch + 1} of {trainer.max_epochs}: {', '.join(figures)}")


def make_trainer(
    settings: Trainer,
    epochs: int,
    folder: Path,
    origin: Origin,
    monitor: str,
    callbacks: Sequence[L.Callback],
    max_gradient_norm: float | None,
) -> L.Trainer:
    """Return a trainer that keeps the best and the last checkpoint in a run's folder, each written
    whole or not at all, and shows a progress bar, or prints a line per epoch if the output is not a
    terminal.

    Args:
        settings: settings of Lightning's trainer; a null precision is `machine.DEFAULT_PRECISION`.
        origin: data and first weights, for the checkpoints.
        monitor: figure of a validation that is greatest for the best weights.
        callbacks: further ones.
        max_gradient_norm: norm to which gradients are clipped; None for none.
    """
    silence_lightning()
    options = asdict(settings)
    if options["precision"] is None:
        options["precision"] = machine.DEFAULT_PRECISION
    options["accelerator"] = machine.accelerator(settings.accelerator)
    plugins: list[Any] = [AtomicCheckpointIO()]
    if SLURMEnvironment.detect() and not TorchElasticEnvironment.detect():
        plugins.append(SLURMEnvironment(auto_requeue=False))  # the same command resumes by itself
    terminal = sys.stdout.isatty()
    progress = TQDMProgressBar(leave=False) if terminal else EpochLines()
    return L.Trainer(
        **options,
        max_epochs=epochs,
        gradient_clip_val=max_gradient_norm,
        callbacks=[
            *callbacks,
            RunCheckpoint(folder / BEST, monitor=monitor, mode="max"),
            RunCheckpoint(folder / LAST),
            OriginRecord(origin),
            EndOnSigterm(),
            progress,
        ],
        enable_progress_bar=terminal,
        plugins=plugins,
        logger=False,
        num_sanity_val_steps=0,
        enable_model_summary=False,
        use_distributed_sampler=False,
        benchmark=False,
    )


def silence_lightning() -> None:
    """Silence Lightning's messages at every start; its import undoes earlier settings."""
    for name in ("lightning.pytorch", "lightning.fabric", "lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)
    for message in KNOWN_WARNINGS:
        warnings.filterwarnings("ignore", message)


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes a checkpoint beside the previous one, which it then replaces.

    Lightning's own goes through the temporary folder, often on another disk: a copy that can be
    cut short."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None
    ) -> None:
        """Write a checkpoint, whole or not at all.

        Raises:
            OSError: the disk is full or not writable; the previous checkpoint stays whole.
        """
        write_tensors(path, checkpoint)


class RunCheckpoint(ModelCheckpoint):
    """Keeps one checkpoint in one file."""

    def __init__(self, file: Path, **settings: Any) -> None:
        settings |= {"enable_version_counter": False, "save_on_train_epoch_end": True}
        super().__init__(file.parent, file.stem, **settings)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        # the state holds absolute paths: in a moved folder, Lightning would forget the best score
        def here(path: str) -> str:
            return path and str(Path(self.dirpath) / Path(path).name)  # type: ignore[arg-type]

        moved_paths = {
            k: here(state_dict[k])
            for k in ("best_model_path", "kth_best_model_path", "last_model_path")
        }
        best = {here(path): score for path, score in state_dict["best_k_models"].items()}
        super().load_state_dict(
            state_dict | moved_paths | {"best_k_models": best, "dirpath": self.dirpath}
        )


class OriginRecord(L.Callback):
    """Writes the origin of a training into each checkpoint, so that it is not evaluated on other
    classes, or resumed on other images or with other weights."""

    def __init__(self, origin: Origin) -> None:
        self.origin = origin

    def on_save_checkpoint(
        self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        checkpoint.update(asdict(self.origin))
