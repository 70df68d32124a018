"""Finished runs and their re-attacks as one frame, a row per run; or a sentence that says why there
is none."""

import shlex
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW
from training.comparison.comparable import (
    Attacks,
    Runs,
    baseline_recipe,
    caveats,
    data_name,
    image_settings,
    protocol_settings,
    require_comparable,
)
from training.comparison.costs import COSTS, own_cost
from training.config.checks import LADDER_SETTINGS
from training.config.schema import Reattack
from training.config.settings import as_argument
from training.runs.layout import METRICS, finished_runs, read_metrics
from training.runs.metrics import RunMetrics, SuiteMetrics

# of the re-attack that is suggested for a run without one
SUGGESTED_PROTOCOL = {"reattack.steps": 50, "reattack.n": 480}

MEAN_ROW, WORST_ROW = "mean of the others", "worst of the others"  # of all scenes but the own
# what the runs of a table share
SHARED_COLUMNS = (
    "data",
    "data_seed",
    "model",
    "scene",
    "n",
    "steps",
    "bound",
    "reattack_seed",
)


class RateCell(NamedTuple):
    """An accuracy of a run: its title, and the cell of suite `recipes` that it is read from."""

    title: str
    table: str
    row: str
    column: str


RATES = {
    "clean": RateCell("clean", "worst_case", "eps_4", "clean"),
    "natural": RateCell("photo", "unseen", OWN_SCENE_ROW, "moire"),
    "unseen_mean": RateCell("unseen, mean", "unseen", MEAN_ROW, "moire"),
    "unseen_worst": RateCell("unseen, worst", "unseen", WORST_ROW, "moire"),
    "worst_4": RateCell("worst case 4/255", "worst_case", "eps_4", "worst"),
    "worst_8": RateCell("worst case 8/255", "worst_case", "eps_8", "worst"),
    "pgd_4": RateCell("PGD 4/255", "worst_case", "eps_4", "pgd"),
}


class RunTable(NamedTuple):
    """The compared runs of a folder.

    Args:
        runs: a row per attacked run. Columns: `recipe`, `seed`; `n`, number of images; outcomes
            (n,) by the names of `RATES`, 1 where the run is right, 0 where it is wrong, the mean
            over scenes in between, to six digits; costs by the names of `COSTS`; `collapsed`,
            whether its training ended in catastrophic overfitting once; `baseline`, recipe that it
            is compared with.
        shared: values of `SHARED_COLUMNS`.
        commands: commands that attack the other runs.
        warnings: sentences for the reader.
    """

    runs: pd.DataFrame
    shared: dict[str, Any]
    commands: list[str]
    warnings: list[str]


def read(root: Path) -> RunTable:
    """Read every finished run of `root`/<recipe>/seed<k>/ that suite `recipes` has attacked in its
    own scene."""
    try:
        trained, warnings = read_classifiers(root)
        table = _table(root, trained)
    except (KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise ValueError(
            f"a metrics.json in {root} holds what no run writes ({error!r}). "
            "Train and attack again."
        ) from error
    return table._replace(warnings=[*table.warnings, *warnings])


def _table(root: Path, trained: Runs) -> RunTable:
    attacked: dict[Path, SuiteMetrics] = {}
    for folder, metrics in trained.items():
        if largest := read_attack(folder, metrics):
            attacked[folder] = largest
    require_comparable(trained, attacked)
    commands = _commands(trained, attacked)
    if not attacked:
        problem = f"no run in {root} was attacked by suite=recipes in its own scene. Run:"
        raise ValueError("\n  ".join([problem, *commands]))
    rows = []
    for folder, attack in attacked.items():
        metrics = trained[folder]
        rows.append(_row(metrics, attack))
        rows[-1]["baseline"] = baseline_recipe(metrics, trained.values())
    runs = pd.DataFrame(rows)
    folder, attack = next(iter(attacked.items()))  # any: they share these
    shared: dict[str, Any] = {"data": data_name(trained.values())}
    shared["data_seed"] = attack.config["data"]["seed"]
    shared |= {"model": trained[folder].model, "scene": trained[folder].scene_name}
    shared |= {name: getattr(attack, name) for name in ("n", "steps", "bound")}
    shared["reattack_seed"] = attack.config["reattack"]["seed"]
    return RunTable(runs, shared, commands, caveats(runs, trained, attacked))


def _commands(trained: Runs, attacked: Attacks) -> list[str]:
    """Return the commands that attack the other runs as those attacked were."""
    protocol = SUGGESTED_PROTOCOL
    if attacked:  # which share theirs
        protocol = protocol_settings(next(iter(attacked.values())))
    starts_alone = all(metrics.recipe == "clean" for metrics in trained.values())
    commands = []
    for folder, metrics in trained.items():
        # the start of other runs needs no row of its own
        if folder in attacked or (metrics.recipe == "clean" and not starts_alone):
            continue
        command = f"python training/reattack.py run={shlex.quote(str(folder))} suite=recipes"
        for key, value in protocol.items():
            name = key.removeprefix("reattack.")
            of_run = metrics.config["reattack"][name]
            taken = getattr(Reattack, name) if key in LADDER_SETTINGS else of_run
            if taken != value:
                command += f" {key}={as_argument(value)}"
        commands.append(command)
    return commands


def _row(metrics: RunMetrics, attack: SuiteMetrics) -> dict[str, Any]:
    row: dict[str, Any] = {"recipe": metrics.recipe, "seed": metrics.seed, "n": attack.n}
    for name, cell in RATES.items():
        row[name] = _correct(attack, cell)
    row |= {name: cost.of_run(metrics) for name, cost in COSTS.items()}
    return row | {"collapsed": own_cost(metrics).collapsed_at is not None}


def _correct(attack: SuiteMetrics, rate: RateCell) -> np.ndarray:
    """Return the outcomes of a cell, one per image; over all scenes but the run's own, their mean
    or those of the worst scene."""
    of_other_scenes = rate.row in (MEAN_ROW, WORST_ROW)
    scenes = []
    for cell in attack.tables[rate.table]:
        in_row = cell["row"] != OWN_SCENE_ROW if of_other_scenes else cell["row"] == rate.row
        if in_row and cell["column"] == rate.column:
            scenes.append(np.array([float(outcome) for outcome in cell["outcomes"]]))
    if not scenes:
        raise KeyError(f"{rate.table}, {rate.row}, {rate.column}")
    if rate.row == WORST_ROW:
        return min(scenes, key=lambda scene: float(scene.mean()))
    return np.mean(scenes, axis=0).round(6)


def read_classifiers(root: Path) -> tuple[dict[Path, RunMetrics], list[str]]:
    """Return the metrics of the finished classifiers in `root`/<recipe>/seed<k>/, and a sentence on
    each that is damaged. A demoiréing network has no adversary and no place in the table."""
    classifiers, warnings = {}, []
    for folder in finished_runs(root):
        values = read_metrics(folder)
        if values is None:
            warnings.append(
                f"{folder / METRICS} is damaged, and the run left out: its command, given again, "
                "writes it anew."
            )
        elif "adversary" in values.get("config", {}) and (metrics := RunMetrics.read(folder)):
            classifiers[folder] = metrics
    if classifiers:
        return classifiers, warnings
    problem = (
        f"no finished run in {root}: it must hold <recipe>/seed<k>/{METRICS}, as "
        "training/fit.py writes them."
    )
    groups = [folder for folder in root.glob("*") if finished_runs(folder)]
    if groups:
        names = ", ".join(shlex.quote(str(path)) for path in sorted(groups))
        problem += f" A table is of one data set and model: pass one of {names}."
    raise ValueError(problem)


def read_attack(folder: Path, metrics: RunMetrics) -> SuiteMetrics | None:
    """Read the largest re-attack, by images and then steps, of a run's final weights in its own
    scene, on its own images; None where there is none."""
    attacks = []
    for path in sorted(folder.glob("reattack/*/recipes")):
        attack = SuiteMetrics.read(path)
        if not attack or attack.scene != metrics.scene:
            continue
        # the weights of an unfinished run can be attacked, too
        is_of_these_weights = metrics.identity in (None, attack.identity)
        if is_of_these_weights and image_settings(attack) == image_settings(metrics):
            attacks.append(attack)
    return max(attacks, key=lambda attack: (attack.n, attack.steps), default=None)
