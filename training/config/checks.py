"""Settings checked against each other and against the machine, before any time is spent."""

from __future__ import annotations

import os
from collections.abc import Sequence

import torch
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.evaluation.tables import DEFAULT_EPS, check_bounds
from training.config.data_sets import DATA, Data
from training.config.scenes import scene_of
from training.config.schema import Adversary, Config, RunConfig, Trainer
from training.config.settings import check, settings_of


def check_classifier(cfg: Config) -> None:
    """Refuse invalid settings of a classifier's data, scene and attack.

    Raises:
        TypeError, ValueError: with what was got and what is allowed.
    """
    check_run(cfg)
    require_used(cfg.data)
    check_adversary(cfg.adversary)
    eps = DEFAULT_EPS if cfg.reattack.eps is None else cfg.reattack.eps
    if len(set(eps)) < len(eps):
        raise ValueError(f"reattack.eps must be different bounds; got {list(eps)}.")
    check_bounds(eps)
    scene, adversary = scene_of(cfg), cfg.adversary
    MoireAttack(nn.Identity(), scene=scene, steps=cfg.reattack.steps)
    MoireAttack(
        nn.Identity(), scene=scene, optimise=tuple(adversary.optimise), draws=adversary.draws
    )


def require_used(cfg: Data) -> None:
    """Refuse settings that the data set would not use.

    Raises:
        ValueError: with what to do.
    """
    for key, declared in settings_of(Data).items():
        value = getattr(cfg, key)
        is_used = not declared.facts.only_for or cfg.name in declared.facts.only_for
        if not is_used and value != getattr(DATA[cfg.name], key):
            raise ValueError(
                f"data.{key}={value} has no effect on data={cfg.name}: leave it out, or name "
                "the data set that it is for, such as data=folder."
            )


def check_adversary(cfg: Adversary) -> None:
    """Refuse settings of an adversary that do not go together.

    Raises:
        ValueError: with what was got, what is allowed and what to do.
    """
    if cfg.kind == "none" and cfg.share:
        raise ValueError(
            f"adversary.share={cfg.share} is the share of images that are attacked, and the kind "
            "none attacks none: use moire_attack or pgd, or adversary.natural for photos without "
            "an attack."
        )
    if cfg.kind != "none" and not (cfg.share and cfg.steps and cfg.eps):
        raise ValueError(
            f"adversary.kind={cfg.kind} needs a share, steps and eps above 0; got "
            f"{cfg.share}, {cfg.steps} and {cfg.eps}. Without an attack, the kind is none."
        )
    moves = Adversary(optimise=cfg.optimise, draws=cfg.draws)
    if cfg.kind != "moire_attack" and moves != Adversary():
        raise ValueError(
            "adversary.optimise and adversary.draws are for adversary.kind=moire_attack; got "
            f"{list(cfg.optimise)}, {cfg.draws} and the kind {cfg.kind}."
        )
    if cfg.share + cfg.natural > 1:
        raise ValueError(
            "adversary.share and adversary.natural are parts of one batch and must not add up to "
            f"more than 1; got {cfg.share} and {cfg.natural}."
        )


def check_run(cfg: RunConfig) -> None:
    """Refuse settings out of their bounds, more devices than there are, and a trainer's other
    settings that cannot be used.

    Raises:
        ValueError: with what was got and what is allowed.
    """
    check(cfg)
    check_devices(cfg.trainer)
    if cfg.trainer.deterministic not in (True, False, "warn"):
        raise ValueError(
            f"trainer.deterministic must be true, false or warn; got {cfg.trainer.deterministic!r}."
        )


def check_devices(trainer: Trainer) -> None:
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
