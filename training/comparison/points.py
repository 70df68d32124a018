"""Finished runs and their re-attacks, read from a folder of runs: a point for each run, or a
sentence that says why there is none."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW
from training.comparison import comparable
from training.runs import costs
from training.system.files import read_metrics

STEPS, N = 50, 480  # of the re-attack that is suggested for a run without one
Metrics = dict[str, Any]

MEAN, WORST = "mean of the others", "worst of the others"  # of all scenes but the own
# accuracies of a run, and the cells of suite `recipes` that they are: table, row, column
RATES = {
    "clean": ("worst_case", "eps_4", "clean"),
    "natural": ("unseen", OWN_SCENE_ROW, "moire"),
    "unseen_mean": ("unseen", MEAN, "moire"),
    "unseen_worst": ("unseen", WORST, "moire"),
    "worst_4": ("worst_case", "eps_4", "worst"),
    "worst_8": ("worst_case", "eps_8", "worst"),
    "pgd_4": ("worst_case", "eps_4", "pgd"),
}


@dataclass(frozen=True)
class Point:
    """One run, attacked again in its own scene.

    Args:
        outcomes: name of a rate to (n,) numbers, one per image: 1 where the run is right, 0 where
            it is wrong, the mean over scenes in between. All runs see the same images.
        seconds: of this run's own training, by its median epoch. start_seconds: of the training
            that made the weights it began with; 0 where it began with random ones. plain_seconds:
            of plain training with the same seed and settings, its start included: the unit of
            costs; None where it is not known.
        passes: forward and backward, per image of its own training. images_per_second: of the same.
        collapsed: whether catastrophic overfitting was seen while it was trained.
        baseline: the recipe of plain training of at least as many epochs; None for plain training
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

    def to_dict(self) -> Metrics:
        """Return a line for a table of runs."""
        line: Metrics = {"recipe": self.recipe, "seed": self.seed}
        line["n"] = len(self.outcomes["clean"])
        for name, outcomes in self.outcomes.items():
            line[name] = float(outcomes.mean())
        for name in ("seconds", "start_seconds", "total_seconds", "plain_seconds", "passes"):
            line[name] = getattr(self, name)
        for name in ("images_per_second", "collapsed", "baseline"):
            line[name] = getattr(self, name)
        return line


class Found(NamedTuple):
    """What a folder of runs holds: its points; what they share; commands that attack the other
    runs; and warnings."""

    points: list[Point]
    shared: Metrics
    commands: list[str]
    warnings: list[str]


def read(root: Path) -> Found:
    """Read every finished run of `root`/<recipe>/seed<k>/ that suite `recipes` has attacked in its
    own scene.

    Raises:
        ValueError: no run, none attacked, runs or re-attacks that cannot be compared, or an
            incomplete file.
    """
    root, notes = _group(root)
    trained = _classifiers(root)
    if not trained:
        raise ValueError(
            f"no finished run in {root}: it must hold <recipe>/seed<k>/metrics.json, as "
            f"training/fit.py writes them. "
            "Pass the folder given as runs=, or the folder of one data set and model in it."
        )
    for folder in _seeds(root):
        if read_metrics(folder) is None:
            notes.append(
                f"{folder / 'metrics.json'} is damaged, and the run left out: its command, given "
                "again, writes it anew."
            )
    try:
        found = _compared(root, trained)
    except KeyError as error:
        raise ValueError(
            f"a metrics.json in {root} lacks {error}: another version of this project wrote it. "
            f"Train and attack again."
        ) from error
    except (TypeError, AttributeError) as error:
        raise ValueError(
            f"a metrics.json in {root} holds what no run writes ({error}). Train and attack again."
        ) from error
    return found._replace(warnings=[*found.warnings, *notes])


def _compared(root: Path, trained: Mapping[Path, Metrics]) -> Found:
    settings = comparable.same_training(trained)
    attacked = _chosen({folder: _attacks(folder, metrics) for folder, metrics in trained.items()})
    protocol = comparable.same_attack(attacked)
    starts_alone = all(metrics["recipe"] == "clean" for metrics in trained.values())
    commands = []
    for folder, metrics in trained.items():
        # the start of other runs needs no row of its own
        wanted = metrics["recipe"] != "clean" or starts_alone
        if wanted and folder not in attacked:
            commands.append(_command(folder, metrics, protocol))
    if not attacked:
        said = f"no run in {root} was attacked by suite=recipes in its own scene. Run:"
        raise ValueError("\n  ".join([said, *commands]))
    points = [_point(folder, trained, again) for folder, again in attacked.items()]
    shared = {
        "data": comparable.data_name(trained.values()),
        "model": settings["model"],
        "scene": settings["scene"],
    }
    for name, value in protocol.items():
        shared[name.removeprefix("reattack.")] = value
    return Found(points, shared, commands, comparable.warnings(trained, attacked))


def _seeds(root: Path) -> list[Path]:
    """Return the folders <recipe>/seed<k> of a folder that hold a finished run."""
    found = sorted(path.parent for path in root.glob("*/*/metrics.json"))
    return [folder for folder in found if re.fullmatch(r"seed-?\d+", folder.name)]


def _classifiers(root: Path) -> dict[Path, Metrics]:
    """Return the metrics of a folder's finished classifiers; a demoiréing network has no adversary
    and no place in the table."""
    found = {}
    for folder in _seeds(root):
        metrics = read_metrics(folder) or {}
        if metrics.get("train") and "adversary" in metrics.get("config", {}):
            found[folder] = metrics
    return found


def _group(root: Path) -> tuple[Path, list[str]]:
    """Return the folder whose runs are read, and a note on those of other data or models, which
    cannot be compared with them.

    Raises:
        ValueError: there are only groups of runs, of which one must be chosen.
    """
    groups = [path for path in sorted(root.glob("*")) if path.is_dir() and _classifiers(path)]
    if not groups:
        return root, []
    named = ", ".join(shlex.quote(str(path)) for path in groups)
    if _classifiers(root):
        note = f"Runs of other data or models are left out; for a table of these pass {named}."
        return root, [note]
    if len(groups) == 1:
        return groups[0], []
    raise ValueError(
        f"{root} holds runs of several data sets or models, which cannot be compared: pass "
        f"one of {named}."
    )


def _attacks(folder: Path, metrics: Metrics) -> list[Metrics]:
    """Return the re-attacks of a run's final weights in its own scene, on its own images."""
    found = []
    for path in sorted(folder.glob("reattack/*/recipes")):
        again = read_metrics(path)
        if not again or again["scene"] != metrics["scene"]:
            continue
        if comparable.images(again) != comparable.images(metrics):
            continue
        # the weights of an unfinished run can be attacked, too; earlier versions did not tell
        identities = {again.get("identity"), metrics.get("identity")} - {None}
        if len(identities) <= 1:
            found.append(again)
    return found


def _chosen(every: Mapping[Path, list[Metrics]]) -> dict[Path, Metrics]:
    """Return a re-attack of each run that has any: of the size that most runs have; of several that
    as many have, with the most images, then the most steps."""
    runs_with: Counter[tuple[int, int]] = Counter()
    for attacks in every.values():
        runs_with.update({_size(again) for again in attacks})
    chosen = {}
    for folder, attacks in every.items():
        if attacks:
            chosen[folder] = max(attacks, key=lambda again: (runs_with[_size(again)], _size(again)))
    return chosen


def _size(again: Metrics) -> tuple[int, int]:
    return again["n"], again["steps"]


def _command(folder: Path, metrics: Metrics, protocol: Metrics) -> str:
    """Return the command that attacks a run as the others were attacked."""
    wanted = protocol or {"reattack.steps": STEPS, "reattack.n": N}
    own = metrics["config"]["reattack"]
    more = ""
    for key, value in wanted.items():
        if own.get(key.removeprefix("reattack.")) != value:
            more += f" {key}={'null' if value is None else value}"
    return f"python training/reattack.py run={shlex.quote(str(folder))} suite=recipes{more}"


def _point(folder: Path, trained: Mapping[Path, Metrics], again: Metrics) -> Point:
    metrics = trained[folder]
    train = metrics["train"]
    seconds = costs.steady_seconds(train)
    return Point(
        metrics["recipe"],
        metrics["seed"],
        outcomes={name: _outcomes(again, *cell) for name, cell in RATES.items()},
        seconds=seconds,
        start_seconds=costs.start_seconds(train, folder, trained),
        plain_seconds=costs.plain_seconds(folder, trained),
        passes=train["passes"],
        images_per_second=train["images_per_second"] * train["seconds"] / seconds,
        collapsed=train.get("collapsed_at") is not None,
        baseline=comparable.baseline(metrics, trained.values()),
    )


def _outcomes(again: Metrics, table: str, row: str, column: str) -> np.ndarray:
    """Return the outcomes of a cell, one per image; over all scenes but the run's own, their mean
    or those of the worst scene."""
    others = row in (MEAN, WORST)
    found = []
    for line in again["tables"][table]:
        wanted = line["row"] != OWN_SCENE_ROW if others else line["row"] == row
        if wanted and line["column"] == column:
            found.append(np.array([float(outcome) for outcome in line["outcomes"]]))
    if not found:
        raise KeyError(f"{table}, {row}, {column}")
    if row == WORST:
        return min(found, key=lambda outcomes: float(outcomes.mean()))
    return np.mean(found, axis=0)
