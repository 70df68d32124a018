"""What a training cost: its epochs, and its time without validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


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
