"""The results of an attack as metrics, beside those of the classifier that it is compared with; and
their reports."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import torch
from torch import nn

from moireaug.evaluation import paired_gain
from moireaug.evaluation.frame import MEASURES, MOIRE_MEASURES
from moireaug.evaluation.suites.ladder import main_attack
from moireaug.mixtures import scenes_of
from training import report
from training.attack.protocol import AttackResult, attack
from training.attack.subject import Subject
from training.config.scenes import scene_of, shrink_text
from training.config.schema import Config, ReattackConfig
from training.report.examples import run_examples, table_examples
from training.runs.layout import REPORT
from training.runs.metrics import PlainMetrics, RunMetrics, SuiteMetrics, TrainCost
from training.runs.run import Run


def ladder_metrics(result: AttackResult) -> dict[str, Any]:
    """Return the fields of `RunMetrics` that a ladder fills."""
    rows, correct = [], {}
    headline = main_attack(result.tables[0]).name
    for cell in result.cells.to_dict("records"):
        row = {"name": cell["row"], "headline": cell["row"] == headline}
        for name in ("eps", "bound", "steps", "control", "targeted", "accuracy"):
            row[name] = cell[name]
        row["accuracy_interval"] = [cell["accuracy_low"], cell["accuracy_high"]]
        row["success"] = None if pd.isna(cell["success"]) else cell["success"]
        row["success_interval"] = [cell["low"], cell["high"]]
        for name in ("n", "counted", "undecided", "seconds"):
            row[name] = cell[name]
        for name in (*MEASURES, *MOIRE_MEASURES):
            if not pd.isna(cell[name]):
                row[name] = cell[name]
        rows.append(row)
        correct[cell["row"]] = cell["outcomes"]
    return {
        "clean_accuracy": rows[0]["accuracy"],
        "reattack": rows,
        "correct": correct,
        "identity": result.runner.model_identity,
        **result.checks,
    }


def run_metrics(cfg: Config, train: TrainCost | None, start: PlainMetrics | None) -> RunMetrics:
    """Return the metrics of a run that is not attacked yet, nor compared."""
    return RunMetrics(
        **metrics_of(cfg), train=train, start=start, baseline=None, gain={}, gain_interval={}
    )


def plain_metrics(cfg: Config, recipe: str, train: TrainCost | None = None) -> PlainMetrics:
    """Return the metrics of a baseline, or of the network whose answers a run keeps, without those
    of an attack."""
    return PlainMetrics(
        recipe=recipe, seed=cfg.seed, data=cfg.data.name, model=cfg.model, train=train
    )


def with_baseline(
    metrics: RunMetrics, baseline: PlainMetrics, ladder: Mapping[str, Any]
) -> RunMetrics:
    """Return the metrics of an attacked run with those of its baseline, and its gain over it."""
    attacked = replace(
        baseline, clean_accuracy=ladder["clean_accuracy"], reattack=ladder["reattack"]
    )
    return replace(metrics, baseline=attacked, **gains(metrics.correct or {}, ladder["correct"]))


def metrics_of(cfg: Config) -> dict[str, Any]:
    """Return the fields of `Metrics` that need no attack: settings, scene, machine and command."""
    scene, size = scene_of(cfg), (cfg.data.size, cfg.data.size)
    return {
        **Run(cfg).facts(),
        "scene_name": scene_title(cfg),
        "scene": scene.to_dict(),
        "plan": "\n\n".join(str(one.plan(size)) for one in scenes_of(scene)),
    }


def scene_title(cfg: Config) -> str:
    """Return the title of a run's scene: the names of its presets, and whether images are crops."""
    names = cfg.scene if isinstance(cfg.scene, (list, tuple)) else [cfg.scene]
    title = ", ".join(names) if all(isinstance(name, str) for name in names) else "custom"
    return title if cfg.shrink is None else f"{title}, shrink {shrink_text(cfg.shrink)}"


def gains(ours: Mapping[str, str], theirs: Mapping[str, str]) -> dict[str, Any]:
    """Return the gain in accuracy over a baseline and its interval, by row, from every image's
    outcome."""
    gain, interval = {}, {}
    for name in ours:
        if name in theirs:
            gain[name], low, high = paired_gain(_is_correct(ours[name]), _is_correct(theirs[name]))
            interval[name] = [low, high]
    return {"gain": gain, "gain_interval": interval}


def _is_correct(text: str) -> torch.Tensor:
    return torch.tensor([outcome == "1" for outcome in text], device="cpu")


class Rival(NamedTuple):
    """A classifier that another is compared with: plain training's, or itself before its training.

    Args:
        metrics: its metrics, without those of an attack.
        records: folder of the records of finished jobs.
    """

    metrics: PlainMetrics
    model: nn.Module
    records: Path


def attack_and_publish(
    subject: Subject, metrics: RunMetrics, rival: Rival | None = None
) -> RunMetrics:
    """Attack a classifier by the ladder, and its rival, write report.html, then metrics.json, and
    print the summary; return the metrics.

    Args:
        metrics: metrics of the classifier, without those of the attack.
    """
    protocol, out = subject.protocol, subject.folder
    result = attack(subject.model, protocol, subject.records, subject.name)
    metrics = replace(metrics, **ladder_metrics(result), time=metrics.time | result.seconds)
    runners = {subject.name: result.runner}
    if rival:
        name = rival.metrics.recipe
        theirs = attack(rival.model, protocol, rival.records, name, check=False)
        metrics = with_baseline(metrics, rival.metrics, ladder_metrics(theirs))
        runners[name] = theirs.runner
    main_condition = main_attack(result.tables[0])
    examples = run_examples(runners, main_condition, subject.splits.classes)
    summary = report.write_run(out / REPORT, metrics, examples)
    metrics.write(out)
    print(*summary, sep="\n")
    print(f"Report: {out / REPORT}")
    return metrics


def publish_suite(cfg: ReattackConfig, subject: Subject, result: AttackResult) -> SuiteMetrics:
    """Write report.html, tables.md, results.csv and metrics.json of a suite, and print its
    summary."""
    out, protocol = subject.folder, subject.protocol
    tables = {}
    for name, cells in result.cells.groupby("table", sort=False):
        columns = cells.drop(columns="table").astype(object)
        tables[str(name)] = columns.where(columns.notna(), None).to_dict("records")
    metrics = SuiteMetrics(
        **metrics_of(cfg),
        **result.checks,
        suite=cfg.suite,
        n=protocol.batches.n,
        steps=protocol.settings.steps,
        eps=protocol.config().middle,
        bound=protocol.settings.bound,
        identity=result.runner.model_identity,
        tables=tables,
        time={**subject.seconds, **result.seconds},
    )
    examples = {}
    for table in result.tables:
        examples[table.name] = table_examples(
            table, result.runner, subject.splits.classes, subject.name, metrics.eps
        )
    summary = report.write_suite(out, metrics, result.tables, result.cells, examples)
    metrics.write(out)
    print(*summary, sep="\n")
    print(f"Report: {out / REPORT}")
    return metrics
