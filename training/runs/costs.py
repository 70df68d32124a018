"""The cost of a training, of its start and of plain training beside it: epochs, and time without
validation."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

Metrics = dict[str, Any]


def cost(
    history: Sequence[Mapping[str, float]], collapsed_at: int | None, images: int
) -> dict[str, Any]:
    """Return the cost of a classifier's training.

    Args:
        history: figures of each epoch.
        collapsed_at: epoch in which it collapsed, if any.
        images: number of images of an epoch.
    """
    seconds = sum(h["seconds"] for h in history)
    return {
        "seconds": seconds,
        "epochs": len(history),
        "images_per_second": images * len(history) / max(seconds, 1e-9),
        "collapsed_at": collapsed_at,
        "history": history,
    }


def with_totals(train: Mapping[str, Any], before: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return `train` with the epochs and seconds of a training and its start together.

    Args:
        train: cost of the training.
        before: cost of the run whose weights it started from, if any.
    """
    epochs, seconds = train["epochs"], train["seconds"]
    if before:
        epochs += before["epochs"]
        seconds += before["seconds"]
    return {**train, "total_epochs": epochs, "total_seconds": seconds}


def steady_seconds(train: Metrics) -> float:
    """Return the time of a training by its median epoch: a machine that slept, or was busy for a
    while, does not make a recipe dear. Epochs after a collapse take more steps, and have a median
    of their own."""
    epochs = [epoch["seconds"] for epoch in train.get("history", ())]
    if not epochs:
        return train["seconds"]
    collapsed_at = train.get("collapsed_at")
    before_collapse = len(epochs) if collapsed_at is None else collapsed_at + 1
    total = 0.0
    for part in (epochs[:before_collapse], epochs[before_collapse:]):
        if part:
            total += statistics.median(part) * len(part)
    return total


def start_seconds(train: Metrics, folder: Path, trained: Mapping[Path, Metrics]) -> float:
    """Return the training time of the weights that a training began with; 0 for random ones.

    Args:
        train: cost of the run in the folder, or of its baseline.
        folder: folder of the run.
        trained: metrics of all runs, by their folders.
    """
    if train["init"] != "clean":
        return 0.0
    start = _beside(folder, trained, "start", "clean")
    if start is None:
        metrics = trained[folder]
        raise ValueError(
            f"{folder} does not say how long its clean start was trained, and there is no finished "
            f"run in {_twin(folder, 'clean')}: "
            f"train recipe clean with seed={metrics['seed']} and the same settings."
        )
    return steady_seconds(start["train"])


def plain_seconds(folder: Path, trained: Mapping[Path, Metrics]) -> float | None:
    """Return the time of plain training with the same seed, its start included; None where it is
    neither in the run's metrics nor in those of a run beside it."""
    baseline: Metrics | None = trained[folder]
    if trained[folder]["recipe"] != "baseline":
        baseline = _beside(folder, trained, "baseline", "baseline")
    if baseline is None:
        return None
    return steady_seconds(baseline["train"]) + start_seconds(baseline["train"], folder, trained)


def _beside(
    folder: Path, trained: Mapping[Path, Metrics], role: str, recipe: str
) -> Metrics | None:
    """Return the metrics of a run's start or baseline: those among its own metrics, else those of
    the finished run of that recipe with the same seed."""
    return trained[folder].get(role) or trained.get(_twin(folder, recipe))


def _twin(folder: Path, recipe: str) -> Path:
    return folder.parent.parent / recipe / folder.name
