"""Training of a run's network: begun, resumed, or read back where it is complete."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import lightning as L

from moireaug.common.files import write_text
from training.runs.layout import BEST, COST, LAST, training_cost
from training.runs.run import Run
from training.system.files import read_checkpoint
from training.system.messages import count_text
from training.system.processes import is_first, print_once
from training.trainer import ranks
from training.trainer.module import RecordedModule

Cost = dict[str, Any]  # the content of train.json


def train(
    run: Run[Any],
    module: RecordedModule,
    trainer: L.Trainer,
    batches_from: Callable[..., L.LightningDataModule],
    finish: Callable[[Mapping[str, Any], float], Cost],
    plan: str,
) -> Cost:
    """Train in a run's folder, or do the rest of it; load the averaged weights that did best on
    validation, and return the cost.

    Args:
        module: network; of a run that is not resumed, with the weights that it starts from.
        batches_from: returns the batches from the epoch `first_epoch` on.
        finish: takes the best checkpoint and the seconds of all epochs, and returns the cost.
        plan: line on the training that begins.

    Raises:
        ValueError: a checkpoint that is missing or damaged, or images that cannot be used.
        ConnectionError: another process of this run was lost.
        FloatingPointError: the loss became nan or infinite.
        OSError: a disk that is full or not writable.
        KeyboardInterrupt: Ctrl-C or SIGTERM; every complete epoch is kept.
    """
    folder, resumes = run.folder, run.can_resume()
    if is_first():
        run.prepare()
        run.write_settings()
    if resumes and (cost := training_cost(folder)):
        module.load_state_dict(read_checkpoint(folder / BEST)["state_dict"])
        print_once(f"Training is complete: the weights are read from {folder / BEST}.")
        return cost
    print_once(plan)
    history = read_checkpoint(folder / LAST)["history"] if resumes else []
    if history:
        print_once(f"Resuming from {folder / LAST} after {progress_text(history)}.")
    batches = batches_from(first_epoch=len(history))
    best, seconds = ranks.fit(trainer, module, batches, folder)
    cost = finish(best, seconds)
    if is_first():
        write_text(folder / COST, json.dumps(cost))
    return cost


def progress_text(history: Sequence[Mapping[str, float]]) -> str:
    """Return how far a training has come, in the steps that its rows count, or in epochs."""
    if "steps" in history[-1]:
        return f"{history[-1]['steps']:.0f} steps"
    return count_text(len(history), "epoch")
