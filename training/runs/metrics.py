"""`metrics.json`: the metrics of a run, or of a suite that attacked it, written and read here."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Self, TypeVar

from training.runs.layout import COST, METRICS, read_metrics, training_cost, write_metrics

VERSION = 2  # of the records
ORIGINAL = "original"  # in place of a recipe: a network before it was trained to keep its answers
# keys that are left out, not null: of what was not attacked, and of a machine that is not known
ATTACK_KEYS = ("clean_accuracy", "reattack", "correct", "identity", "trust", "trust_n")
Record = TypeVar("Record")


@dataclass(frozen=True)
class TrainCost:
    """The cost of a training, validation left out of its seconds.

    Args:
        init: first weights: "random" or "clean", those of the recipe of that name.
        passes: forward and backward passes per image, the mean over all epochs.
        seconds: time of all epochs.
        collapsed_at: epoch in which it collapsed, if any.
        wall_seconds: time with validation.
        best_epoch: epoch of the weights that are kept.
        total_epochs, total_seconds: epochs and seconds with those of its start.
        new_share, equal_answers: of a network that was to keep its answers, share of the trained
            weights in those that are kept, and of the validation images that these answer as
            before.
    """

    init: str
    passes: float
    seconds: float
    epochs: int
    images_per_second: float
    collapsed_at: int | None
    history: list[dict[str, float]]
    wall_seconds: float
    best_epoch: int
    total_epochs: int
    total_seconds: float
    new_share: float | None = None
    equal_answers: float | None = None

    @property
    def steady_seconds(self) -> float:
        """Time by the median epoch: a machine that slept, or was busy for a while, does not make a
        recipe dear. Epochs after a collapse take more steps, and have a median of their own."""
        epochs = [epoch["seconds"] for epoch in self.history]
        before_collapse = len(epochs) if self.collapsed_at is None else self.collapsed_at + 1
        total = 0.0
        for part in (epochs[:before_collapse], epochs[before_collapse:]):
            if part:
                total += statistics.median(part) * len(part)
        return total

    @classmethod
    def of(cls, values: Any, folder: Path) -> Self:
        """Return the cost of these plain values, which may be a stranger's, of a run's folder."""
        return _record(cls, values, folder / COST)

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read the cost from a run's train.json or metrics.json; None where there is neither."""
        values = training_cost(folder)
        return None if values is None else cls.of(values, folder)


@dataclass(frozen=True, kw_only=True)
class PlainMetrics:
    """The metrics of a start or a baseline, in those of the run beside it.

    Args:
        recipe, seed, data, model: settings of the run.
        train: cost of its training; None where it is not known.
        clean_accuracy, reattack: as in `RunMetrics`, of a baseline.
        environment: machine and versions of its training, where they are known.
    """

    recipe: str
    seed: int
    data: str
    model: str
    train: TrainCost | None
    clean_accuracy: float | None = None
    reattack: list[dict[str, Any]] | None = None
    environment: dict[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """The metrics that a run and a suite share.

    Args:
        recipe, seed, data, model: settings of the run.
        scene_name, scene, plan: scene of the photos: its title, its fields, and its plans.
        config: settings that the result depends on.
        identity: digest of the attacked model.
        trust, trust_n: checks of whether the figures can be trusted, and their number of images.
        time: seconds spent, by phase.
    """

    version: int = VERSION
    recipe: str
    seed: int
    data: str
    model: str
    scene_name: str
    scene: Any
    plan: str
    config: dict[str, Any]
    fingerprint: str
    environment: dict[str, Any]
    command: str
    identity: str | None = None
    trust: list[dict[str, Any]] | None = None
    trust_n: int | None = None
    time: dict[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of metrics.json."""
        values = asdict(self)
        for part in (values, values.get("start"), values.get("baseline")):
            for name in (*ATTACK_KEYS, "environment"):
                if part and part.get(name, 0) is None:
                    del part[name]
        return values

    def write(self, folder: Path) -> None:
        """Write metrics.json, which replaces train.json."""
        write_metrics(folder, self.to_dict())

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read a folder's metrics; None where they are missing or damaged."""
        values = read_metrics(folder)
        return None if values is None else _record(cls, values, folder / METRICS)


@dataclass(frozen=True, kw_only=True)
class RunMetrics(Metrics):
    """The metrics of a run.

    Args:
        train: cost of its training; None where it was not trained here.
        clean_accuracy: share of the test images that are right.
        reattack: rows of the ladder.
        correct: outcome of every image, by row: a string of 0 and 1.
        start: metrics of the run whose weights it started from.
        baseline: metrics of plain training of at least as many epochs in all.
        gain, gain_interval: gain in accuracy over the baseline, by row, and its interval.
    """

    train: TrainCost | None
    clean_accuracy: float | None = None
    reattack: list[dict[str, Any]] | None = None
    correct: dict[str, str] | None = None
    start: PlainMetrics | None
    baseline: PlainMetrics | None
    gain: dict[str, float]
    gain_interval: dict[str, list[float]]

    def plain(self) -> PlainMetrics:
        """Return the part that the metrics of a run beside it hold, without an attack."""
        return PlainMetrics(
            recipe=self.recipe,
            seed=self.seed,
            data=self.data,
            model=self.model,
            train=self.train,
            environment=self.environment,
        )


@dataclass(frozen=True, kw_only=True)
class SuiteMetrics(Metrics):
    """The metrics of a suite.

    Args:
        steps, eps: steps of each attack, and the bound of most.
        bound: what the eps of noise on a reading counts: "codes" or "light".
    """

    suite: str
    n: int
    steps: int
    eps: float
    bound: str
    tables: dict[str, list[dict[str, Any]]]


NESTED_RECORDS: dict[str, Any] = {
    "train": TrainCost,
    "start": PlainMetrics,
    "baseline": PlainMetrics,
}


def _record(schema: type[Record], values: Any, path: Path) -> Record:
    """Return a record of the plain values in a file."""
    names = {one.name: one for one in fields(schema)}  # type: ignore[arg-type]
    if not isinstance(values, Mapping) or not values.keys() <= names.keys():
        raise ValueError(f"{path} holds what no run writes. Train and attack again.")
    arguments = dict(values)
    for name, one in names.items():
        required = one.default is MISSING and one.default_factory is MISSING
        if (name == "version" and values.get(name) != VERSION) or (required and name not in values):
            raise ValueError(
                f"{path} lacks {name!r}: another version of this project wrote it. "
                "Train and attack again."
            )
        if name in NESTED_RECORDS and values[name] is not None:
            arguments[name] = _record(NESTED_RECORDS[name], values[name], path)
    if schema is TrainCost and not _has_numbers(values):
        raise ValueError(f"{path} holds what no run writes. Train and attack again.")
    return schema(**arguments)


def _has_numbers(cost: Mapping[str, Any]) -> bool:
    """Return whether the figures of a `TrainCost`, which may be a stranger's, are numbers."""
    if not isinstance(cost["history"], list):
        return False
    rows = [{**cost, "history": 0, "init": 0}, *cost["history"]]
    is_plain = all(isinstance(row, Mapping) and all(map(_is_number, row.values())) for row in rows)
    return is_plain and cost["init"] in ("random", "clean")


def _is_number(value: Any) -> bool:
    if isinstance(value, bool):
        return False
    try:
        return value is None or not math.isinf(value)
    except (TypeError, OverflowError):  # no number; an integer beyond all floats
        return False
