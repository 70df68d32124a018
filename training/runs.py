"""A run's folder: how far it has come, whose settings it was made with, and who works on it."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import json
import os
import platform
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.utilities import rank_zero_only
from omegaconf import DictConfig, OmegaConf

from training.files import read_checkpoint as read_checkpoint
from training.files import read_json, read_metrics, read_settings
from training.schema import HOME, RECIPES, Adversary, Config

try:
    import fcntl
except ImportError:  # Windows, where nothing is locked
    fcntl = None  # type: ignore[assignment]

# What a run's result does not depend on.
_FREE, _FREE_DATA = ("runs", "resume"), ("workers", "download")


def settings(cfg: DictConfig) -> dict[str, Any]:
    """The settings that a run's result depends on, as plain values."""
    plain: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    data = {k: v for k, v in plain["data"].items() if k not in _FREE_DATA}
    return {k: v for k, v in plain.items() if k not in _FREE} | {"data": data}


def fingerprint(values: Mapping[str, Any]) -> str:
    """Twelve hex digits that change with any setting."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:12]


def folder(cfg: DictConfig | Config) -> Path:
    """Where a run is kept: `runs`/<recipe>/seed<k>, and for other than the default data and model, whose runs do not
    compare with these, `runs`/<data>-<model>/<recipe>/seed<k>, of which the default one is left out."""
    return Path(cfg.runs) / group(cfg) / cfg.recipe / f"seed{cfg.seed}"


def group(cfg: DictConfig | Config) -> str:
    """The runs that compare with this one: "" for the default data and model, else what differs."""
    data, model = cfg.data.name, cfg.model
    if data == "folder" and cfg.data.root:
        own = re.sub(r"[^\w.-]+", "_", Path(cfg.data.root).resolve().name)
        data = f"folder-{own}"
    return "-".join(name for name, home in zip((data, model), HOME, strict=True) if name != home)


def make(path: Path) -> None:
    """Make a folder, and see that files can be written there, before anything is spent on what goes into it.

    Raises:
        ValueError: a file in its place, or a disk that is full or may not be written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(bytes(4096))
            file.flush()
    except (FileExistsError, NotADirectoryError):
        raise ValueError(
            f"{path} cannot be a folder: there is a file of that name, or of one above it. Move it, or pass runs=DIR."
        ) from None
    except OSError as error:
        raise ValueError(
            f"{path} cannot be written ({error.strerror}): mend that, or pass runs=DIR on another disk."
        ) from error


def plain_twin(cfg: DictConfig) -> DictConfig:
    """Recipe `clean` with all else as in this run."""
    plain = OmegaConf.load(RECIPES / "clean.yaml")
    return OmegaConf.merge(cfg, {"adversary": asdict(Adversary())}, plain, {"recipe": "clean", "resume": None})


def stage(cfg: DictConfig) -> str:
    """How far the run of these settings has come in its folder.

    Returns:
        "new"; "begun" where an epoch is over; "trained"; "finished"; "other" where the folder holds another run.
    """
    path = folder(cfg)
    best, told = (path / "best.ckpt").is_file(), read_metrics(path)
    if _mark(path) != fingerprint(settings(cfg)):
        return "other" if _mark(path) or told or any(path.glob("*.ckpt")) else "new"
    if best and told:
        return "finished"
    if best and read_json(path / "train.json"):
        return "trained"
    return "begun" if (path / "last.ckpt").is_file() else "new"


def _mark(path: Path) -> str | None:
    """The fingerprint of the run that a folder holds."""
    try:
        return fingerprint(settings(OmegaConf.create(read_settings(path / "config.yaml"))))
    except FileNotFoundError:
        return None
    except Exception:  # not YAML, or not a run's
        return "damaged"


def goes_on(cfg: DictConfig) -> bool:
    """Whether there is something to go on from, and this is wanted. The same in every process of a run."""
    return cfg.resume is not False and stage(cfg) in ("begun", "trained")


def insist(cfg: DictConfig, *others: DictConfig) -> None:
    """Refuse `resume=true` of a run that has nothing to go on from, and neither have the others.

    Raises:
        ValueError: no such run, or one that was made with other settings.
    """
    if any(goes_on(c) for c in (cfg, *others)):
        return
    path = folder(cfg)
    if stage(cfg) == "other":
        raise ValueError(
            f"resume=true, but {path} was made with other settings, see {path / 'config.yaml'}: give those, or leave "
            "resume=true out, and that run is moved aside."
        )
    raise ValueError(f"resume=true needs {path / 'last.ckpt'}, which does not exist: leave it out to begin.")


def prepare(cfg: DictConfig) -> None:
    """Make a run's folder ready: what is not gone on with is moved aside, so that nothing is lost; what would make
    this run look whole before it is goes."""
    path, at = folder(cfg), stage(cfg)
    if at == "other" or (cfg.resume is False and at != "new"):
        name = f"{path.name}-{_mark(path) or 'old'}"
        names = itertools.chain([name], (f"{name}-{i}" for i in itertools.count(2)))
        aside = next(p for p in map(path.with_name, names) if not p.exists())
        os.replace(path, aside)
        print(f"{path} held {'a run with other settings' if at == 'other' else 'this run'}; it is now {aside}")
    path.mkdir(parents=True, exist_ok=True)
    for stale in (path / "metrics.json", path / "report.html", *path.glob(".*.tmp")):
        stale.unlink(missing_ok=True)


@contextlib.contextmanager
def held(path: Path) -> Iterator[None]:
    """Keep a run's folder to this command. The kernel lets go of it when the command ends, however it ends.

    Raises:
        ValueError: another command works on it.
    """
    if fcntl is None or rank_zero_only.rank != 0:
        yield
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_name(f".{path.name}.lock").open("w") as file:  # beside it, for the folder itself may be moved
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # flock would live on in a DataLoader's worker
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EAGAIN):  # else a disk that knows no locks
                raise ValueError(
                    f"another command is at work in {path}: wait for it, or give another seed=N or runs=DIR."
                ) from None
        yield


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
