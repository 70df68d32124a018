"""Warnings beside a table of runs, on figures that a reader should not trust."""

from __future__ import annotations

import pandas as pd

from training.comparison.comparable import Attacks, Runs
from training.runs.metrics import RunMetrics
from training.runs.run import PLAIN_RECIPES
from training.system.messages import count_text


def caveats(runs: pd.DataFrame, trained: Runs, attacked: Attacks) -> list[str]:
    """Return the warnings beside a table, each a sentence.

    Args:
        runs: runs of the table, as in `RunTable`.
        trained: metrics of all runs, by their folders.
        attacked: metrics of the re-attacks, by the same folders.
    """
    sentences = []
    machines = set()
    for folder in attacked:
        machines |= _machines(trained[folder])
    if len(machines) > 1:
        names = "; ".join(sorted(machines))
        sentences.append(
            f"The runs were trained in different ways ({names}): do not compare their times."
        )
    has_no_baseline = runs["baseline"].isna() & ~runs["recipe"].isin(PLAIN_RECIPES)
    for recipe in runs["recipe"][has_no_baseline].unique():
        sentences.append(
            f"No gain is given for {recipe}: baseline was trained for fewer epochs, or from "
            "another start. Train it with the same train.epochs and train.init."
        )
    for folder, attack in attacked.items():
        failed = [check["name"] for check in attack.trust or [] if check["verdict"] == "fail"]
        if failed:
            sentences.append(f"Checks of the attack failed on {folder}: {'; '.join(failed)}.")
    return sentences


def _machines(metrics: RunMetrics) -> set[str]:
    """Return the machines, and the precision if one was set, on which a run, its start and its
    baseline were trained."""
    settings = ""
    for name, default in (("devices", 1), ("num_nodes", 1), ("precision", None)):
        if metrics.config["trainer"][name] != default:
            settings += f", {name}={metrics.config['trainer'][name]}"
    machines = set()
    for run in (metrics, metrics.start, metrics.baseline):
        if run and run.environment:
            machine = run.environment["device"]
            if machine == "cpu":
                threads = count_text(run.environment["threads"], "thread")
                machine = f"{run.environment['cpu']}, {threads}"
            machines.add(machine + settings)
    return machines
