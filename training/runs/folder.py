"""A run's folder: how far the run has come, with which settings, and who works on it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from moireaug.files import write_text
from training.config.schema import (
    DEFAULT_DATA,
    RECIPES,
    Adversary,
    Config,
    RunConfig,
    as_config,
    as_values,
)
from training.config.settings import settings_of
from training.system.files import free_name, read_json, read_metrics, read_settings
from training.system.locks import locked
from training.system.processes import is_first

PLAIN_RECIPES = ("clean", "baseline")  # without an adversary: what the others are compared with


def result_settings(cfg: RunConfig) -> dict[str, Any]:
    """Return the settings that a run's result depends on, as plain values."""
    return without_free_settings(as_values(cfg), type(cfg))


def without_free_settings(values: dict[str, Any], schema: type[RunConfig]) -> dict[str, Any]:
    """Return the plain values of a schema's settings, without those that no result depends on."""
    for key, one in settings_of(schema).items():
        *outer, last = key.split(".")
        if not one.facts.changes_result:
            inner = values[outer[0]] if outer else values
            inner.pop(last, None)
    return values


def fingerprint_of(values: Mapping[str, Any] | list[Any]) -> str:
    """Return twelve hex digits that change with any setting."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:12]


def run_folder(cfg: RunConfig) -> Path:
    """Return where a run is kept.

    That is `runs`/<recipe>/seed<k> for the default data and model, else
    `runs`/<data>-<model>/<recipe>/seed<k> without the part that is the default: runs in different
    groups cannot be compared.
    """
    return Path(cfg.runs) / group_of(cfg.data, cfg.model) / cfg.recipe / f"seed{cfg.seed}"


def group_of(data: Any, model: str) -> str:
    """Return the name of a group of runs that can be compared: "" for default data and model.

    Args:
        data: settings of the data; its name and root are used.
    """
    name = data.name
    if name == "folder" and data.root:
        own = re.sub(r"[^\w.-]+", "_", Path(data.root).resolve().name)
        name = f"folder-{own}"
    usual = (DEFAULT_DATA, Config.model)
    return "-".join(part for part in (name, model) if part not in usual)


def start_config(cfg: Config) -> Config | None:
    """Return the settings of the run whose weights this one starts from: those of recipe `clean`.

    None where it starts from random weights, or from those of `weights=`.
    """
    return _plain(cfg, "clean") if cfg.train.init == "clean" else None


def baseline_config(cfg: Config) -> Config | None:
    """Return the settings of the plain run that this one is compared with.

    That is recipe `baseline` from the same start, in at least as many epochs; all other settings
    are the same. None for `baseline` and `clean` themselves.
    """
    if cfg.recipe in PLAIN_RECIPES:
        return None
    baseline = _plain(cfg, "baseline")
    return replace(baseline, train=replace(baseline.train, init=cfg.train.init))


def _plain(cfg: Config, recipe: str) -> Config:
    """Return the settings of a recipe of `PLAIN_RECIPES`, all else as in `cfg`."""
    own = OmegaConf.load(RECIPES / f"{recipe}.yaml")
    no_adversary = {"adversary": asdict(Adversary())}
    merged = OmegaConf.merge(
        OmegaConf.structured(cfg), no_adversary, own, {"recipe": recipe, "resume": None}
    )
    return as_config(merged)  # type: ignore[arg-type]


def write_settings(cfg: RunConfig) -> None:
    """Write config.yaml into a run's folder."""
    values = OmegaConf.create(as_values(cfg))
    write_text(run_folder(cfg) / "config.yaml", OmegaConf.to_yaml(values))


@dataclass(frozen=True)
class RunFolder:
    """A run's folder, and the run that is wanted in it.

    Args:
        folder: where it is kept. schema: of its settings. mark: their fingerprint.
        resume: as in the schema: None where possible, True or fail, False never.
    """

    folder: Path
    schema: type[RunConfig]
    mark: str
    resume: bool | None

    def stage(self) -> str:
        """Return how far the run in the folder has come.

        Returns:
            "new"; "begun" after the first epoch; "trained"; "finished"; "other" for another run.
        """
        path = self.folder
        best, metrics = (path / "best.ckpt").is_file(), read_metrics(path)
        there = self._mark_there()
        if there != self.mark:
            holds_a_run = there or metrics or any(path.glob("*.ckpt"))
            return "other" if holds_a_run else "new"
        if best and metrics:
            return "finished"
        if best and read_json(path / "train.json"):
            return "trained"
        return "begun" if (path / "last.ckpt").is_file() else "new"

    def can_resume(self) -> bool:
        """Return whether it can and may be resumed; the same in all its processes."""
        return self.resume is not False and self.stage() in ("begun", "trained")

    def prepare(self) -> None:
        """Make the folder ready: nothing in it is lost, and nothing makes the run look finished.

        What is not resumed is moved aside.
        """
        path, at = self.folder, self.stage()
        if at == "other" or (self.resume is False and at != "new"):
            aside = free_name(path.with_name(f"{path.name}-{self._mark_there() or 'old'}"))
            os.replace(path, aside)
            what = "a run with other settings" if at == "other" else "this run"
            print(f"{path} held {what}; it is now {aside}")
        path.mkdir(parents=True, exist_ok=True)
        for stale in (path / "metrics.json", path / "report.html", *path.glob(".*.tmp")):
            stale.unlink(missing_ok=True)

    def _mark_there(self) -> str | None:
        """Return the fingerprint of the run in the folder; None for none, "damaged" if
        unreadable."""
        try:
            values = as_values(OmegaConf.create(read_settings(self.folder / "config.yaml")))
            return fingerprint_of(without_free_settings(values, self.schema))
        except FileNotFoundError:
            return None
        except Exception:  # not YAML, or not a run's
            return "damaged"


def run_of(cfg: RunConfig) -> RunFolder:
    """Return the run of these settings."""
    return RunFolder(run_folder(cfg), type(cfg), fingerprint_of(result_settings(cfg)), cfg.resume)


def require_resumable(run: RunFolder, *others: RunFolder) -> None:
    """Refuse `resume=true` where neither this run nor any of the others can be resumed.

    Raises:
        ValueError: there is no such run, or it was made with other settings.
    """
    for own in (run, *others):
        if own.can_resume():
            return
    path = run.folder
    if run.stage() == "other":
        raise ValueError(
            f"resume=true, but {path} was made with other settings, see {path / 'config.yaml'}: "
            "pass those, or leave resume=true out, and that run is moved aside."
        )
    raise ValueError(
        f"resume=true needs {path / 'last.ckpt'}, which does not exist: leave it out to start."
    )


@contextlib.contextmanager
def locked_run(path: Path) -> Iterator[None]:
    """Lock a run's folder for this command; the kernel releases it however the command ends.

    Raises:
        ValueError: another command works on it.
    """
    if not is_first():
        yield
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    busy = f"another command is at work in {path}: wait for it, or pass another seed=N or runs=DIR."
    with locked(path.with_name(f".{path.name}.lock"), busy):  # the folder itself may be moved
        yield
