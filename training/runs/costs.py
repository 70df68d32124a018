"""What a training cost, its start and plain training beside it: epochs, and time without
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
    """Return what a classifier's training cost.

    Args:
        history: a row per epoch. collapsed_at: the epoch in which it collapsed, if any.
        images: that an epoch trains on.
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
        train: `train` of a run's metrics.
        before: that of the run whose weights it started from, if any.
    """
    epochs, seconds = train["epochs"], train["seconds"]
    if before:
        epochs += before["epochs"]
        seconds += before["seconds"]
    return {**train, "total_epochs": epochs, "total_seconds": seconds}


def steady_seconds(train: Metrics) -> float:
    """Return the time of a training whose every epoch takes as long as the median one: a machine
    that slept, or was busy for a while, does not make a recipe dear. After a collapse, epochs of
    more steps have a median of their own."""
    epochs = [epoch["seconds"] for epoch in train.get("history", ())]
    if not epochs:
        return train["seconds"]
    collapsed_at = train.get("collapsed_at")
    same = len(epochs) if collapsed_at is None else collapsed_at + 1
    total = 0.0
    for part in (epochs[:same], epochs[same:]):
        if part:
            total += statistics.median(part) * len(part)
    return total


def start_seconds(train: Metrics, folder: Path, trained: Mapping[Path, Metrics]) -> float:
    """Return the training time of the weights that a training began with; 0 for random ones.

    Args:
        train: of the run in the folder, or of the baseline that it is compared with.
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
    """Return the time of plain training with the same seed, its start included; None where neither
    the run nor a run beside it says."""
    plain: Metrics | None = trained[folder]
    if trained[folder]["recipe"] != "baseline":
        plain = _beside(folder, trained, "baseline", "baseline")
    if plain is None:
        return None
    return steady_seconds(plain["train"]) + start_seconds(plain["train"], folder, trained)


def _beside(
    folder: Path, trained: Mapping[Path, Metrics], role: str, recipe: str
) -> Metrics | None:
    """Return the metrics of a run's start or baseline: as the run kept them, else those of the
    finished run of that recipe with the same seed."""
    return trained[folder].get(role) or trained.get(_twin(folder, recipe))


def _twin(folder: Path, recipe: str) -> Path:
    return folder.parent.parent / recipe / folder.name
