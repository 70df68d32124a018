"""A run's folder: what marks it as whole, whose settings it was made with, and how its files are written."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from training.schema import RECIPES, Adversary, Config

# What a run's result does not depend on.
_FREE = ("runs", "resume")


def settings(cfg: DictConfig) -> dict[str, Any]:
    """The settings that a run's result depends on, as plain values."""
    plain = OmegaConf.to_container(cfg, resolve=True)
    return {k: v for k, v in plain.items() if k not in _FREE}  # type: ignore[union-attr]


def fingerprint(values: Mapping[str, Any]) -> str:
    """Twelve hex digits that change with any setting."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:12]


def folder(cfg: DictConfig | Config) -> Path:
    return Path(cfg.runs) / cfg.recipe / f"seed{cfg.seed}"


def plain_twin(cfg: DictConfig) -> DictConfig:
    """Recipe `clean` with all else as in this run."""
    plain = OmegaConf.load(RECIPES / "clean.yaml")
    return OmegaConf.merge(cfg, {"adversary": asdict(Adversary())}, plain, {"recipe": "clean", "resume": False})


def read_checkpoint(path: Path) -> dict[str, Any]:
    """A Lightning checkpoint, on the CPU.

    Raises:
        ValueError: a file that is missing or damaged.
    """
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
        found["state_dict"], found["epoch"]
        return found
    except Exception as error:  # whichever byte was hit: UnpicklingError, EOFError, RuntimeError, KeyError ...
        raise ValueError(
            f"The checkpoint {path} could not be read ({type(error).__name__}). It may be missing or damaged: train "
            "again without resume=true, or name another run."
        ) from error


def read_metrics(path: Path) -> dict[str, Any] | None:
    """The metrics of a whole run, or None where there is none; `metrics.json` is written last."""
    try:
        return json.loads((path / "metrics.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def prepare(path: Path, mark: str, *, resume: bool) -> None:
    """Make a run's folder ready: a run with other settings is moved aside, so that nothing is lost; what would make
    this one look whole before it is goes.

    Raises:
        ValueError: `resume` of a run that is not there, or was made with other settings.
    """
    config, last = path / "config.yaml", path / "last.ckpt"
    old = fingerprint(settings(OmegaConf.load(config))) if config.is_file() else None
    if resume and not (old and last.is_file()):
        raise ValueError(f"resume=true needs {last}, which does not exist: leave it out to train from the start.")
    if resume and old != mark:
        raise ValueError(
            f"{path} was made with other settings, see {config}: resume it with those, or leave resume out."
        )
    if old and old != mark:
        aside = path.with_name(f"{path.name}-{old}")
        if not aside.exists():
            os.replace(path, aside)
            print(f"{path} held a run with other settings; it is now {aside}")
    path.mkdir(parents=True, exist_ok=True)
    for name in ("metrics.json", "report.html", *(() if resume else ("best.ckpt", "last.ckpt"))):
        (path / name).unlink(missing_ok=True)


def environment() -> dict[str, Any]:
    """Versions and machine, for the record."""
    import kornia
    import lightning
    import numpy
    import torchvision

    return {
        "python": platform.python_version(),
        **{m.__name__: m.__version__ for m in (torch, torchvision, kornia, lightning, numpy)},
        "cpu": _cpu(),
        "threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def command(argv: list[str] | None = None) -> str:
    """The command line of this run, as a user would type it."""
    argv = sys.argv if argv is None else argv
    return shlex.join(["python", f"training/{Path(argv[0]).name}", *argv[1:]])
