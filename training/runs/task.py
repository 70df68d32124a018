"""The way of a run from its settings to its report, whatever its network learns."""

import time
from abc import ABC, abstractmethod
from typing import Any, Generic, TypeVar

from training.config import scenes
from training.config.schema import RunConfig
from training.runs.identity import Origin
from training.runs.resume import require_resumable, require_same_origin
from training.runs.run import Run
from training.system.processes import is_first

Settings = TypeVar("Settings", bound=RunConfig)
Data = TypeVar("Data")  # with the `files` and `classes` of an `Origin`
Metrics = dict[str, Any]  # the content of metrics.json


class Task(ABC, Generic[Settings, Data]):
    """What a network learns: the steps of `fit` that depend on it, in their order."""

    @abstractmethod
    def check(self, cfg: Settings) -> None:
        """Refuse invalid settings before any time is spent."""

    @abstractmethod
    def finished(self, run: Run[Settings]) -> tuple[Metrics, list[str]] | None:
        """Return the metrics of a finished run and their summary for the terminal; None where there
        is something left to do."""

    @abstractmethod
    def runs_before(self, run: Run[Settings]) -> list[Run[Settings]]:
        """Return the runs that are trained first, unless they were before."""

    @abstractmethod
    def load(self, cfg: Settings) -> Data:
        """Load the data."""

    @abstractmethod
    def try_out(self, run: Run[Settings], data: Data) -> None:
        """Make the network and the trainer once, before any run is moved or any time is spent."""

    @abstractmethod
    def train_and_test(self, run: Run[Settings], data: Data, data_seconds: float) -> Metrics:
        """Train, test and report, or do the rest of it, as `fit`; `data_seconds` is the time that
        the data and the trial took."""


def fit(cfg: Settings, task: Task[Settings, Any]) -> Metrics:
    """Train, test and report a run, or do the rest of it; return its metrics, {} in all processes
    but the first.

    Raises:
        TypeError, ValueError: invalid settings, before any time is spent.
        ConnectionError, FloatingPointError, OSError: as `training.trainer.train.train`.
    """
    cfg = scenes.with_files(cfg)
    task.check(cfg)
    run = Run(cfg)
    if cfg.resume is not False:
        require_same_origin(run, Origin.of(cfg.weights))
        if finished := task.finished(run):  # only read, and where nothing can be written too
            metrics, summary = finished
            hint = f"{run.folder} is already finished; resume=false trains it again."
            if is_first():
                print(*summary, hint, sep="\n")
            return metrics
    with run.locked():
        if cfg.resume and is_first():
            require_resumable(run, *task.runs_before(run))
        start_time = time.perf_counter()
        data = task.load(cfg)
        if cfg.resume is not False:
            require_same_origin(run, Origin.of(cfg.weights, data))
        task.try_out(run, data)
        return task.train_and_test(run, data, time.perf_counter() - start_time)
