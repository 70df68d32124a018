"""The time that a run's start and plain training beside it took."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from training.runs.metrics import PlainMetrics, RunMetrics, TrainCost


def start_seconds(train: TrainCost, folder: Path, trained: Mapping[Path, RunMetrics]) -> float:
    """Return the training time of the weights that a training began with; 0 for random ones.

    Args:
        train: cost of the run in the folder, or of its baseline.
        folder: folder of the run.
        trained: metrics of all runs, by their folders.
    """
    if train.init != "clean":
        return 0.0
    start = trained[folder].start or trained.get(_twin(folder, "clean"))
    if start is None or start.train is None:
        raise ValueError(
            f"{folder} does not say how long its clean start was trained, and there is no finished "
            f"run in {_twin(folder, 'clean')}: train recipe clean with "
            f"seed={trained[folder].seed} and the same settings."
        )
    return start.train.steady_seconds


def plain_seconds(folder: Path, trained: Mapping[Path, RunMetrics]) -> float | None:
    """Return the time of plain training with the same seed, its start included; None where it is
    neither in the run's metrics nor in those of a run beside it."""
    baseline: RunMetrics | PlainMetrics | None = trained[folder]
    if trained[folder].recipe != "baseline":
        baseline = trained[folder].baseline or trained.get(_twin(folder, "baseline"))
    if baseline is None or baseline.train is None:
        return None
    train = baseline.train
    return train.steady_seconds + start_seconds(train, folder, trained)


def _twin(folder: Path, recipe: str) -> Path:
    """Return the folder of the run of another recipe with the same seed."""
    return folder.parent.parent / recipe / folder.name
