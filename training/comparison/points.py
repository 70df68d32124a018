"""Finished runs and their re-attacks as points of a table, read from a folder of runs; or a
sentence that says why there are none."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW
from training.comparison import comparable, costs
from training.comparison.caveats import caveats
from training.comparison.folders import (
    choose_attacks,
    group_in,
    read_attacks,
    read_classifiers,
    run_folders,
)
from training.config.settings import as_argument
from training.runs.metrics import RunMetrics, SuiteMetrics
from training.system.files import read_metrics

# of the re-attack that is suggested for a run without one
SUGGESTED_STEPS, SUGGESTED_IMAGES = 50, 480

MEAN_ROW, WORST_ROW = "mean of the others", "worst of the others"  # of all scenes but the own
# accuracies of a run, and the cells of suite `recipes` that they are: table, row, column
RATES = {
    "clean": ("worst_case", "eps_4", "clean"),
    "natural": ("unseen", OWN_SCENE_ROW, "moire"),
    "unseen_mean": ("unseen", MEAN_ROW, "moire"),
    "unseen_worst": ("unseen", WORST_ROW, "moire"),
    "worst_4": ("worst_case", "eps_4", "worst"),
    "worst_8": ("worst_case", "eps_8", "worst"),
    "pgd_4": ("worst_case", "eps_4", "pgd"),
}


@dataclass(frozen=True)
class Point:
    """One run, attacked again in its own scene.

    Args:
        recipe, seed: settings of the run.
        outcomes: outcomes (n,) of each rate, one per image: 1 where the run is right, 0 where it is
            wrong, the mean over scenes in between. All runs see the same images.
        seconds: time of this run's own training, by its median epoch.
        start_seconds: time of the training of its first weights; 0 for random ones.
        plain_seconds: time of plain training with the same seed and settings, its start included:
            the unit of costs; None where it is not known.
        passes: forward and backward passes per image of its own training.
        images_per_second: speed of its own training.
        collapsed: whether its training ended in catastrophic overfitting once.
        baseline: recipe of plain training of at least as many epochs; None for plain training
            itself, and where the plain runs took fewer.
    """

    recipe: str
    seed: int
    outcomes: dict[str, np.ndarray]
    seconds: float
    start_seconds: float
    plain_seconds: float | None
    passes: float
    images_per_second: float
    collapsed: bool
    baseline: str | None

    @property
    def total_seconds(self) -> float:
        return self.seconds + self.start_seconds

    def to_dict(self) -> dict[str, Any]:
        """Return a line for a table of runs."""
        line: dict[str, Any] = {"recipe": self.recipe, "seed": self.seed}
        line["n"] = len(self.outcomes["clean"])
        for name, outcomes in self.outcomes.items():
            line[name] = float(outcomes.mean())
        for name in ("seconds", "start_seconds", "total_seconds", "plain_seconds", "passes"):
            line[name] = getattr(self, name)
        for name in ("images_per_second", "collapsed", "baseline"):
            line[name] = getattr(self, name)
        return line


class RunTable(NamedTuple):
    """The compared runs of a folder.

    Args:
        points: attacked runs.
        shared: settings that they share.
        commands: commands that attack the other runs.
        warnings: sentences for the reader.
    """

    points: list[Point]
    shared: dict[str, Any]
    commands: list[str]
    warnings: list[str]


def read(root: Path) -> RunTable:
    """Read every finished run of `root`/<recipe>/seed<k>/ that suite `recipes` has attacked in its
    own scene.

    Raises:
        ValueError: no run, none attacked, runs or re-attacks that cannot be compared, or an
            incomplete file.
    """
    root, notes = group_in(root)
    trained = read_classifiers(root)
    if not trained:
        raise ValueError(
            f"no finished run in {root}: it must hold <recipe>/seed<k>/metrics.json, as "
            "training/fit.py writes them. Pass the folder given as runs=, or the folder of one "
            "data set and model in it."
        )
    for folder in run_folders(root):
        if read_metrics(folder) is None:
            notes.append(
                f"{folder / 'metrics.json'} is damaged, and the run left out: its command, given "
                "again, writes it anew."
            )
    try:
        table = _table(root, trained)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"a metrics.json in {root} holds what no run writes ({error!r}). "
            "Train and attack again."
        ) from error
    return table._replace(warnings=[*table.warnings, *notes])


def _table(root: Path, trained: Mapping[Path, RunMetrics]) -> RunTable:
    settings = comparable.shared_training(trained)
    attacks = {folder: read_attacks(folder, metrics) for folder, metrics in trained.items()}
    attacked = choose_attacks(attacks)
    protocol = comparable.shared_protocol(attacked)
    starts_alone = all(metrics.recipe == "clean" for metrics in trained.values())
    commands = []
    for folder, metrics in trained.items():
        # the start of other runs needs no row of its own
        has_row = metrics.recipe != "clean" or starts_alone
        if has_row and folder not in attacked:
            commands.append(_command(folder, metrics, protocol))
    if not attacked:
        problem = f"no run in {root} was attacked by suite=recipes in its own scene. Run:"
        raise ValueError("\n  ".join([problem, *commands]))
    points = [_point(folder, trained, attack) for folder, attack in attacked.items()]
    shared = {
        "data": comparable.data_name(trained.values()),
        "model": settings["model"],
        "scene": settings["scene"],
    }
    for name, value in protocol.items():
        shared[name.removeprefix("reattack.")] = value
    return RunTable(points, shared, commands, caveats(trained, attacked))


def _command(folder: Path, metrics: RunMetrics, protocol: dict[str, Any]) -> str:
    """Return the command that attacks a run as the others were attacked."""
    settings = protocol or {"reattack.steps": SUGGESTED_STEPS, "reattack.n": SUGGESTED_IMAGES}
    run_settings = metrics.config["reattack"]
    overrides = ""
    for key, value in settings.items():
        if run_settings[key.removeprefix("reattack.")] != value:
            overrides += f" {key}={as_argument(value)}"
    return f"python training/reattack.py run={shlex.quote(str(folder))} suite=recipes{overrides}"


def _point(folder: Path, trained: Mapping[Path, RunMetrics], attack: SuiteMetrics) -> Point:
    metrics = trained[folder]
    train = metrics.train
    if train is None:
        raise ValueError(f"{folder} does not say how long it was trained. Train it again.")
    seconds = train.steady_seconds
    return Point(
        metrics.recipe,
        metrics.seed,
        outcomes={name: _outcomes(attack, *cell) for name, cell in RATES.items()},
        seconds=seconds,
        start_seconds=costs.start_seconds(train, folder, trained),
        plain_seconds=costs.plain_seconds(folder, trained),
        passes=train.passes,
        images_per_second=train.images_per_second * train.seconds / seconds,
        collapsed=train.collapsed_at is not None,
        baseline=comparable.baseline_recipe(metrics, trained.values()),
    )


def _outcomes(attack: SuiteMetrics, table: str, row: str, column: str) -> np.ndarray:
    """Return the outcomes of a cell, one per image; over all scenes but the run's own, their mean
    or those of the worst scene."""
    of_other_scenes = row in (MEAN_ROW, WORST_ROW)
    scenes = []
    for cell in attack.tables[table]:
        in_row = cell["row"] != OWN_SCENE_ROW if of_other_scenes else cell["row"] == row
        if in_row and cell["column"] == column:
            scenes.append(np.array([float(outcome) for outcome in cell["outcomes"]]))
    if not scenes:
        raise KeyError(f"{table}, {row}, {column}")
    if row == WORST_ROW:
        return min(scenes, key=lambda outcomes: float(outcomes.mean()))
    return np.mean(scenes, axis=0)
