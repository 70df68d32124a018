"""frontier.csv: a line per run, with its figures and the outcome of each image, written and read
here."""

import math
from pathlib import Path

import numpy as np
import pandas as pd

from training.comparison.costs import COSTS
from training.comparison.frame import RATES, SHARED_COLUMNS, RunTable

OUTCOMES = "{}_outcomes"  # name of the column of a CSV with an accuracy's outcomes


def to_csv(table: RunTable) -> str:
    """Return a table as CSV: each run with its accuracies, and last the outcome of each image."""
    means, outcomes = {}, {}
    for name in RATES:
        means[name] = table.runs[name].map(np.mean)
        lines = [" ".join(f"{one:g}" for one in run) for run in table.runs[name]]
        outcomes[OUTCOMES.format(name)] = lines
    return table.runs.assign(**means, **table.shared, **outcomes).to_csv(index=False)


def read_csv(file: Path) -> RunTable:
    """Read the table that `to_csv` wrote."""
    try:
        runs = pd.read_csv(file, dtype={OUTCOMES.format(name): str for name in RATES})
        _require_figures(runs)
        outcomes = {name: _outcomes_of(runs, name) for name in RATES}
        shared = {name: runs[name].unique().tolist() for name in SHARED_COLUMNS}
    except (OSError, ValueError) as error:  # ValueErrors: no UTF-8, no CSV, nothing in it
        raise ValueError(
            f"{file} is no frontier.csv ({error}). Pass the folder of the runs instead."
        ) from error
    for name, values in shared.items():
        if len(values) != 1:
            raise ValueError(f"{file} has runs of different {name}: {values}. Keep those of one.")
    repeated = runs[runs.duplicated(["recipe", "seed"])]
    if len(repeated):
        recipe, seed = repeated[["recipe", "seed"]].iloc[0]
        raise ValueError(f"{file} has {recipe}, seed {seed}, more than once. Keep one line of it.")
    values = {name: value for name, (value,) in shared.items()}
    runs = runs.drop(columns=[OUTCOMES.format(name) for name in RATES]).assign(**outcomes)
    return RunTable(runs, values, commands=[], warnings=[])


def _require_figures(runs: pd.DataFrame) -> None:
    """Refuse lines of a CSV that lack a name or a figure, or have one that no run has."""
    needed = {"recipe", "seed", "baseline", "collapsed", *RATES, *map(OUTCOMES.format, RATES)}
    if missing := {*needed, *COSTS, *SHARED_COLUMNS} - set(runs.columns):
        raise ValueError(f"it lacks {', '.join(sorted(missing))}")
    if runs["recipe"].isna().any():
        raise ValueError("a line names no recipe")
    if runs["recipe"].eq("recipe").any():
        raise ValueError("the head of another table is among its lines: delete it")
    figures = runs[["seed", *RATES, *COSTS, "collapsed"]].astype(float)
    figures = figures.fillna({"plain_seconds": 1.0})  # which need not be known
    for name in figures:
        bound, ends = "at least 0", "left"
        if name in ("total_seconds", "plain_seconds"):  # of the ratio
            bound, ends = "above 0", "neither"
        is_valid = figures[name].between(0, np.inf, inclusive=ends)
        if not is_valid.all():
            raise ValueError(f"{name} must be {bound}; got {runs[name][~is_valid].tolist()}")


def _outcomes_of(runs: pd.DataFrame, name: str) -> list[np.ndarray]:
    """Return the outcomes (n,) of each line of a CSV."""
    column = OUTCOMES.format(name)
    outcomes = [np.array(str(text).split(), float) for text in runs[column]]
    for one, n, mean in zip(outcomes, runs["n"], runs[name], strict=True):
        if len(one) != n or not ((one >= 0) & (one <= 1)).all():
            raise ValueError(f"{column} must be {n} numbers between 0 and 1 in each line")
        if not math.isclose(one.mean(), mean, abs_tol=1e-9):
            raise ValueError(f"{name} is {mean}, but the mean of {column} {one.mean():.6g}")
    return outcomes
