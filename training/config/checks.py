"""Settings checked against each other and against the machine, before any time is spent."""

from __future__ import annotations

import os
from collections.abc import Sequence

import torch

from training.config.schema import Config, RunConfig, Trainer
from training.config.settings import check


def check_classifier(cfg: Config) -> None:
    """Refuse settings of a classifier's run that are out of bounds.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    check_run(cfg)
    eps = cfg.reattack.eps or []
    if len(set(eps)) < len(eps):
        raise ValueError(f"reattack.eps must be different bounds; got {list(eps)}.")


def check_run(cfg: RunConfig) -> None:
    """Refuse settings out of their bounds, more devices than there are, and a trainer's other
    settings that cannot be used.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    check(cfg)
    _check_devices(cfg.trainer)
    if cfg.trainer.deterministic not in (True, False, "warn"):
        raise ValueError(
            f"trainer.deterministic must be true, false or warn; got {cfg.trainer.deterministic!r}."
        )


def _check_devices(trainer: Trainer) -> None:
    """Refuse more devices than there are; -1, "auto" and lists of GPUs are left to Lightning, which
    takes no such names of processes on a CPU.

    Raises:
        ValueError: with how many there are.
    """
    kind, devices = trainer.accelerator, trainer.devices
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
    available = max(2, os.cpu_count() or 1) if on_cpu else gpus
    unit = "processes (CPU cores)" if on_cpu else "GPUs"
    if isinstance(devices, str) and devices.isdigit():
        devices = int(devices)
    if devices == "auto" or (not on_cpu and (devices == -1 or isinstance(devices, Sequence))):
        return
    if type(devices) is not int or not 1 <= devices <= available:
        raise ValueError(
            f"trainer.devices must be 1 to {available} {unit}, or auto; got {devices}."
        )
