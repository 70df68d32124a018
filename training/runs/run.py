"""A run: its settings, its folder, and its stage there; the plain runs that belong to it."""

import contextlib
import functools
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from omegaconf import OmegaConf

from moireaug.common.files import write_text
from training.config.recipes import PLAIN_RECIPES, plain_training
from training.config.schema import Adversary, Config, RunConfig
from training.runs.identity import (
    group_of,
    result_fingerprint,
    result_settings,
    training_fingerprint,
)
from training.runs.layout import (
    BEST,
    COST,
    LAST,
    METRICS,
    REPORT,
    SETTINGS,
    read_metrics,
    run_folder,
    training_cost,
)
from training.system import machine
from training.system.files import free_name, locked, make_folder, read_settings
from training.system.processes import is_first

RESULT_KEYS = {"reattack", "test"}  # of metrics.json: a classifier's, a demoiréing network's
Settings = TypeVar("Settings", bound=RunConfig)


@dataclass(frozen=True)
class Run(Generic[Settings]):
    """A run, which its folder may hold already, in part or whole."""

    config: Settings

    @property
    def folder(self) -> Path:
        """Folder of the run: `runs`/<recipe>/seed<k> for the default data and model, else
        `runs`/<data>-<model>/<recipe>/seed<k> without the part that is the default, as runs in
        different groups cannot be compared."""
        cfg = self.config
        return run_folder(Path(cfg.runs) / group_of(cfg.data, cfg.model), cfg.recipe, cfg.seed)

    @functools.cached_property
    def settings(self) -> dict[str, Any]:
        """Settings that the result depends on, as plain values."""
        return result_settings(asdict(self.config), type(self.config))

    @functools.cached_property
    def fingerprint(self) -> str:
        """Twelve hex digits that change with any of these settings."""
        return result_fingerprint(self.settings)

    @functools.cached_property
    def training_fingerprint(self) -> str:
        """Twelve hex digits that change with any setting that the weights depend on."""
        return training_fingerprint(self.settings, type(self.config))

    def facts(self) -> dict[str, Any]:
        """Return what the metrics of any run say of its settings, machine and command."""
        cfg = self.config
        return {
            "recipe": cfg.recipe,
            "seed": cfg.seed,
            "data": cfg.data.name,
            "model": cfg.model,
            "config": self.settings,
            "fingerprint": self.fingerprint,
            "environment": machine.environment(cfg.trainer.accelerator),
            "command": machine.command(),
        }

    def stage(self) -> str:
        """Return how far the run in the folder has come.

        Returns:
            "new"; "begun" after the first epoch; "trained", and not tested with these settings;
            "finished"; "other" for another training.
        """
        path, metrics = self.folder, read_metrics(self.folder) or {}
        fingerprint = self._training_fingerprint_in_folder()
        if fingerprint != self.training_fingerprint:
            holds_a_run = fingerprint or metrics or any(path.glob("*.ckpt"))
            return "other" if holds_a_run else "new"
        if (path / BEST).is_file() and training_cost(path):
            return "finished" if self._has_results(metrics) else "trained"
        return "begun" if (path / LAST).is_file() else "new"

    def can_resume(self) -> bool:
        """Return whether its training can and may be resumed, or is complete; the same in all its
        processes."""
        stages = ("begun", "trained", "finished")
        return self.config.resume is not False and self.stage() in stages

    def prepare(self) -> None:
        """Make the folder ready for training: a run that is not resumed is moved aside, and nothing
        makes one whose training is not complete look finished."""
        path, stage = self.folder, self.stage()
        if stage == "other" or (self.config.resume is False and stage != "new"):
            suffix = self._training_fingerprint_in_folder() or "old"
            aside = free_name(path.with_name(f"{path.name}-{suffix}"))
            os.replace(path, aside)
            other_run = "a run with other settings" if stage == "other" else "this run"
            print(
                f"{path} held {other_run}; it is now {aside}. To go on with that one, move it back "
                "and pass its settings."
            )
        path.mkdir(parents=True, exist_ok=True)
        stale_files = list(path.glob(".*.tmp"))
        if self.stage() in ("new", "begun"):
            stale_files += [path / COST, path / METRICS, path / REPORT]
        for stale in stale_files:
            stale.unlink(missing_ok=True)

    def write_settings(self) -> None:
        """Write config.yaml into the folder."""
        values = OmegaConf.create(asdict(self.config))
        write_text(self.folder / SETTINGS, OmegaConf.to_yaml(values))

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Make the folder, and lock it for this command."""
        if is_first():
            make_folder(self.folder)
        with locked_folder(self.folder):
            yield

    def _has_results(self, metrics: Mapping[str, Any]) -> bool:
        """Return whether these metrics are of a test with the settings of this run."""
        if RESULT_KEYS.isdisjoint(metrics):
            return False
        try:
            settings = result_settings(metrics["config"], type(self.config))
            return result_fingerprint(settings) == self.fingerprint
        except Exception:  # not a run's settings
            return False

    def _training_fingerprint_in_folder(self) -> str | None:
        """Return the fingerprint of the training in the folder; None for none, "damaged" where its
        settings are not YAML, or not a run's.

        Raises:
            OSError: they cannot be read now, and may be whole.
        """
        try:
            values, schema = read_settings(self.folder / SETTINGS), type(self.config)
            return training_fingerprint(result_settings(values, schema), schema)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError:
            raise
        except Exception:  # not YAML, or not a run's
            return "damaged"


def start_of(run: Run[Config]) -> Run[Config] | None:
    """Return the run whose weights this one starts from: that of recipe `clean`.

    None where it starts from random weights, or from those of `weights=`."""
    return _plain_run(run.config, "clean") if run.config.train.init == "clean" else None


def baseline_of(run: Run[Config]) -> Run[Config] | None:
    """Return the plain run that this one is compared with.

    That is recipe `baseline` from the same start, in at least as many epochs; all other settings
    are the same. None for `baseline` and `clean` themselves, and where a network is to keep its
    answers, which is compared with itself before."""
    cfg = run.config
    if cfg.recipe in PLAIN_RECIPES or cfg.train.target == "answers":
        return None
    baseline = _plain_run(cfg, "baseline").config
    return Run(replace(baseline, train=replace(baseline.train, init=cfg.train.init)))


def _plain_run(cfg: Config, recipe: str) -> Run[Config]:
    """Return the run of a recipe of `PLAIN_RECIPES`, all other settings as in `cfg`."""
    train = plain_training(recipe, cfg.train)
    return Run(replace(cfg, recipe=recipe, adversary=Adversary(), train=train, resume=None))


@contextlib.contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """Lock a folder of results for this command; the kernel releases it however that ends."""
    if not is_first():
        yield
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    busy = f"another command is at work in {path}: wait for it, or pass another seed=N or runs=DIR."
    with locked(path.with_name(f".{path.name}.lock"), busy):  # the folder itself may be moved
        yield
