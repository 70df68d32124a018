"""The bounds of every number in a run's settings, checked before any time is spent."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from numbers import Real
from operator import attrgetter
from typing import Any

import torch

from moireaug.scene.fields import one_of
from training.schema import Config, RunConfig, Trainer

Bounds = tuple[float, float | None]  # the least and the greatest value; None is no bound
SEEDS = 2**32 - 1
# weights are float32 in all of them: the average, the attack and every re-attack need that
PRECISIONS = ("32-true", "32", "bf16-mixed", "16-mixed")

ACCELERATORS = ("auto", "cpu", "gpu", "cuda", "mps")

# of a classifier's run
BOUNDS: dict[str, Bounds] = {
    "seed": (0, SEEDS),
    "data.size": (16, 8192),
    "data.train": (1, None),
    "data.val": (1, None),
    "data.test": (1, None),
    "data.workers": (0, 1024),
    "adversary.share": (0, 1),
    "adversary.natural": (0, 1),
    "adversary.eps": (0, 1),
    "adversary.steps": (0, 10_000),
    "adversary.warmup": (0, 1),
    "train.epochs": (1, None),
    "train.length": (0.01, 1),
    "train.batch_size": (1, None),
    "train.lr": (1e-8, 10),
    "train.momentum": (0, 0.9999),
    "train.weight_decay": (0, 1),
    "train.label_smoothing": (0, 0.99),
    "train.ema": (0, 0.999999),
    "trainer.num_nodes": (1, 100_000),
    "reattack.n": (1, None),
    "reattack.batch_size": (1, None),
    "reattack.steps": (0, 100_000),
    "reattack.seed": (0, SEEDS),
}


def check(cfg: Config) -> None:
    """Refuse settings of a classifier's run that are out of bounds.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    check_run(cfg, BOUNDS)
    eps = cfg.reattack.eps or []
    if len(set(eps)) < len(eps):
        raise ValueError(f"reattack.eps must be different bounds; got {list(eps)}.")


def check_run(cfg: RunConfig, numbers: Mapping[str, Bounds]) -> None:
    """Refuse numbers out of bounds, more devices than there are, and a trainer's other settings
    that cannot be used.

    A null is not checked: the schema's types say where it is allowed.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    for key, (low, high) in numbers.items():
        _number(key, attrgetter(key)(cfg), low, high)
    _devices(cfg.trainer)
    if cfg.trainer.deterministic not in (True, False, "warn"):
        raise ValueError(
            f"trainer.deterministic must be true, false or warn; got {cfg.trainer.deterministic!r}."
        )
    if cfg.trainer.precision is not None:
        one_of("trainer.precision", str(cfg.trainer.precision), PRECISIONS)


def _number(key: str, value: Any, low: float, high: float | None) -> None:
    if value is None:
        return
    allowed = f"at least {low}" if high is None else f"in [{low}, {high}]"
    most = math.inf if high is None else high
    if (
        isinstance(value, bool)
        or not isinstance(value, Real)
        or not math.isfinite(value)
        or not low <= float(value) <= most
    ):
        raise ValueError(f"{key} must be {allowed}; got {value}.")


def _devices(trainer: Trainer) -> None:
    """Refuse more devices than there are; -1, "auto" and lists of GPUs are left to Lightning, which
    takes no such names of processes on a CPU.

    Raises:
        ValueError: with how many there are.
    """
    kind, asked = trainer.accelerator, trainer.devices
    one_of("trainer.accelerator", kind, ACCELERATORS)
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if kind in ("gpu", "cuda") and not gpus:
        raise ValueError(
            f"trainer.accelerator={kind} needs a GPU that CUDA can use, and there is none: "
            "pass cpu."
        )
    on_cpu = kind == "cpu" or (kind == "auto" and not gpus)
    if not on_cpu and kind not in ("auto", "gpu", "cuda"):
        return
    # two processes can be tried on any machine
    there = max(2, os.cpu_count() or 1) if on_cpu else gpus
    what = "processes (CPU cores)" if on_cpu else "GPUs"
    if isinstance(asked, str) and asked.isdigit():
        asked = int(asked)
    if asked == "auto" or (not on_cpu and (asked == -1 or isinstance(asked, Sequence))):
        return
    if type(asked) is not int or not 1 <= asked <= there:
        raise ValueError(f"trainer.devices must be 1 to {there} {what}, or auto; got {asked}.")
