"""Captures timed in both executions: by the engine and by the reference."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from benchmarks import measure
from moireaug import Scene, Shot, capture, engine

EXECUTIONS = ("engine", "reference")


def taking(scene: Scene, shown: Tensor) -> Callable[[], Tensor]:
    """Return a capture of images in a shot that is drawn and planned once."""
    shot = draw(scene, shown)
    return lambda: capture(shown, shot)


def draw(scene: Scene, shown: Tensor) -> Shot:
    return scene.sample(len(shown), tuple(shown.shape[-2:]), torch.Generator().manual_seed(0))


def in_both(
    calls: dict[str, Callable], settings: dict[str, Any], n: int
) -> dict[str, dict[str, measure.Timing]]:
    """Return the times per image, of n, by the engine, where it can run, and by the reference."""
    repeats, warmup, budget = settings["repeats"], settings["warmup"], settings["budget"]
    # differences of milliseconds need many runs
    ours = measure.timed_together(calls, 4 * repeats, warmup, 4 * budget)
    with engine.reference():
        plain = measure.timed_together(calls, repeats, warmup, budget)
    each = {"engine": ours, "reference": plain}
    return {
        execution: {name: t / n for name, t in times.items()} for execution, times in each.items()
    }
