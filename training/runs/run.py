"""A run: its settings, its folder, and how far it has come there."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

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
from training.system.files import (
    free_name,
    make_folder,
    read_json,
    read_metrics,
    read_settings,
)
from training.system.locks import locked
from training.system.processes import is_first

PLAIN_RECIPES = ("clean", "baseline")  # without an adversary: what the others are compared with
Settings = TypeVar("Settings", bound=RunConfig)


@dataclass(frozen=True)
class Run(Generic[Settings]):
    """A run that is wanted, which its folder may hold already, in part or whole.

    Args:
        config: its settings.
    """

    config: Settings

    @property
    def folder(self) -> Path:
        """Where it is kept: `runs`/<recipe>/seed<k> for the default data and model, else
        `runs`/<data>-<model>/<recipe>/seed<k> without the part that is the default, as runs in
        different groups cannot be compared."""
        cfg = self.config
        return Path(cfg.runs) / group_of(cfg.data, cfg.model) / cfg.recipe / f"seed{cfg.seed}"

    @property
    def settings(self) -> dict[str, Any]:
        """What its result depends on, as plain values."""
        return result_settings(self.config)

    @property
    def fingerprint(self) -> str:
        """Twelve hex digits that change with any of these."""
        return fingerprint_of(self.settings)

    def stage(self) -> str:
        """Return how far the run in the folder has come.

        Returns:
            "new"; "begun" after the first epoch; "trained"; "finished"; "other" for another run.
        """
        path = self.folder
        best, metrics = (path / "best.ckpt").is_file(), read_metrics(path)
        present = self._fingerprint_in_folder()
        if present != self.fingerprint:
            holds_a_run = present or metrics or any(path.glob("*.ckpt"))
            return "other" if holds_a_run else "new"
        if best and metrics:
            return "finished"
        if best and read_json(path / "train.json"):
            return "trained"
        return "begun" if (path / "last.ckpt").is_file() else "new"

    def can_resume(self) -> bool:
        """Return whether it can and may be resumed; the same in all its processes."""
        return self.config.resume is not False and self.stage() in ("begun", "trained")

    def prepare(self) -> None:
        """Make the folder ready: nothing in it is lost, and nothing makes the run look finished.

        What is not resumed is moved aside.
        """
        path, stage = self.folder, self.stage()
        if stage == "other" or (self.config.resume is False and stage != "new"):
            aside = free_name(
                path.with_name(f"{path.name}-{self._fingerprint_in_folder() or 'old'}")
            )
            os.replace(path, aside)
            moved = "a run with other settings" if stage == "other" else "this run"
            print(f"{path} held {moved}; it is now {aside}")
        path.mkdir(parents=True, exist_ok=True)
        for stale in (path / "metrics.json", path / "report.html", *path.glob(".*.tmp")):
            stale.unlink(missing_ok=True)

    def write_settings(self) -> None:
        """Write config.yaml into the folder."""
        values = OmegaConf.create(as_values(self.config))
        write_text(self.folder / "config.yaml", OmegaConf.to_yaml(values))

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Make the folder, and lock it for this command.

        Raises:
            ValueError: it cannot be written, or another command works on it.
        """
        if is_first():
            make_folder(self.folder)
        with locked_folder(self.folder):
            yield

    def _fingerprint_in_folder(self) -> str | None:
        """Return the fingerprint of the run in the folder; None for none, "damaged" if
        unreadable."""
        try:
            values = as_values(OmegaConf.create(read_settings(self.folder / "config.yaml")))
            return fingerprint_of(_without_free(values, type(self.config)))
        except FileNotFoundError:
            return None
        except Exception:  # not YAML, or not a run's
            return "damaged"


def start_of(run: Run[Config]) -> Run[Config] | None:
    """Return the run whose weights this one starts from: that of recipe `clean`.

    None where it starts from random weights, or from those of `weights=`.
    """
    return _plain(run.config, "clean") if run.config.train.init == "clean" else None


def baseline_of(run: Run[Config]) -> Run[Config] | None:
    """Return the plain run that this one is compared with.

    That is recipe `baseline` from the same start, in at least as many epochs; all other settings
    are the same. None for `baseline` and `clean` themselves.
    """
    cfg = run.config
    if cfg.recipe in PLAIN_RECIPES:
        return None
    plain = _plain(cfg, "baseline").config
    return Run(replace(plain, train=replace(plain.train, init=cfg.train.init)))


def _plain(cfg: Config, recipe: str) -> Run[Config]:
    """Return the run of a recipe of `PLAIN_RECIPES`, all other settings as in `cfg`."""
    own = OmegaConf.load(RECIPES / f"{recipe}.yaml")
    no_adversary = {"adversary": asdict(Adversary())}
    merged = OmegaConf.merge(
        OmegaConf.structured(cfg), no_adversary, own, {"recipe": recipe, "resume": None}
    )
    return Run(as_config(merged))  # type: ignore[arg-type]


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


def result_settings(cfg: RunConfig) -> dict[str, Any]:
    """Return the settings that a result depends on, as plain values."""
    return _without_free(as_values(cfg), type(cfg))


def _without_free(values: dict[str, Any], schema: type[RunConfig]) -> dict[str, Any]:
    """Return the plain values of a schema's settings, without those that no result depends on."""
    for key, one in settings_of(schema).items():
        *outer, last = key.split(".")
        if not one.facts.changes_result:
            inner = values[outer[0]] if outer else values
            inner.pop(last, None)
    return values


def fingerprint_of(values: Mapping[str, Any] | list[Any]) -> str:
    """Return twelve hex digits that change with any value."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:12]


@contextlib.contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """Lock a folder of results for this command; the kernel releases it however the command ends.

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
