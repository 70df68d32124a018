"""The phases of a recipe: the plain runs that it needs, its own training, attack and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from moireaug.evaluation import report
from training.attack.protocol import Attacked, Protocol, attack, protocol_of
from training.attack.results import about, compare, describe, publish, write_metrics
from training.config.schema import Config
from training.data.load import load
from training.data.splits import Splits
from training.runs.resume import (
    damage,
    metrics_of_trained,
    other_data,
    other_weights,
    require_same_data,
    trained_run,
)
from training.runs.run import Run, baseline_of, start_of
from training.system.files import read_metrics
from training.system.processes import is_first, say

if TYPE_CHECKING:
    from training.classifier.module import Classifier

Metrics = dict[str, Any]


def report_finished(run: Run[Config]) -> Metrics:
    """Print the summary of a finished run and return its metrics.

    One that was trained as the start or baseline of another run is attacked and reported now.
    """
    known = read_metrics(run.folder) or {}
    if not is_first():
        return known
    if "trust" in known:
        report.show(report.run_parts(known))
    else:
        splits = load(run.config.data)
        require_same_data(run, splits)
        attacked = attack_trained(run, protocol_of(run.config, splits), check=True)
        trained_on = known["environment"]
        known |= {**about(run.config), **describe(attacked), "environment": trained_on}
        run.write_settings()
        seconds = {**(known.get("time") or {}), **attacked.seconds}
        results = {run.config.recipe: attacked}
        known = publish(run.folder, known, results, splits.classes, seconds)
    print(f"{run.folder} is already finished; resume=false trains it again.")
    return known


def plain_runs(run: Run[Config], splits: Splits) -> tuple[Metrics | None, Metrics | None]:
    """Return the metrics of the start and the baseline, reused or trained; None for neither."""
    start = baseline = None
    if wanted := start_of(run):
        start = plain_run(wanted, splits, None, role="start")
    if wanted := baseline_of(run):
        baseline = plain_run(wanted, splits, start, role="baseline")
    return start, baseline


def plain_run(run: Run[Config], splits: Splits, start: Metrics | None, *, role: str) -> Metrics:
    """Return the metrics of a start or baseline: reused, or trained and not attacked.

    A damaged one is moved aside.

    Args:
        start: metrics of the run whose weights it starts from, if any.
        role: "start" or "baseline", for what is printed.
    """
    with run.locked():
        if reason := damage(run) or other_weights(run) or other_data(run, splits):
            say(f"The {role} cannot be reused and is trained again: {reason}.")
            run = Run(replace(run.config, resume=False))
        elif known := metrics_of_trained(run):
            say(f"The {role} is reused from {run.folder}.")
            return known
        else:
            say(f"The {role} comes first: recipe {run.config.recipe}, with the same settings.")
        _, train = train_run(run, splits, start)
        if not is_first():
            return {}
        metrics = compare(run.config, {}, train, start, None)
        return write_metrics(run.folder, metrics | {"time": {"train": train["wall_seconds"]}})


def train_run(
    run: Run[Config], splits: Splits, start: Metrics | None
) -> tuple[Classifier, dict[str, Any]]:
    """Train a run in its folder, or what is left of it; see `train_model`.

    Args:
        start: metrics of the run whose weights it starts from, if any.
    """
    from training.classifier.train import train_model  # Lightning, which takes seconds to import

    if is_first():
        run.prepare()
    return train_model(run, splits, before=start["train"] if start else None)


def attack_trained(run: Run[Config], protocol: Protocol, *, check: bool = False) -> Attacked:
    """Attack a run that was trained, reusing what its records hold."""
    trained = trained_run(run)
    records = trained.folder / "records"
    return attack(trained.model(), protocol, records, run.config.recipe, check=check)


def complete(
    run: Run[Config],
    splits: Splits,
    start: Metrics | None,
    baseline: Metrics | None,
    seconds: Mapping[str, float],
) -> Metrics:
    """Train, attack, compare and report one run; returns its metrics, {} in all but one process.

    Args:
        start, baseline: metrics of the runs beside it. seconds: spent so far, by phase.
    """
    classifier, train = train_run(run, splits, start)
    if not is_first():
        return {}
    recipe, protocol = run.config.recipe, protocol_of(run.config, splits)
    own = attack(classifier.model, protocol, run.folder / "records", recipe)
    results = {recipe: own}
    # also where its records are there: a folder's images may have changed since
    if baseline and (other := baseline_of(run)):
        results[other.config.recipe] = attack_trained(other, protocol)
        baseline = baseline | describe(results[other.config.recipe])
    metrics = compare(run.config, describe(own), train, start, baseline)
    seconds = {**seconds, "train": train["wall_seconds"], **own.seconds}
    return publish(run.folder, metrics, results, splits.classes, seconds)
