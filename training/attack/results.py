"""The results of an attack as metrics, beside those of the runs that it is compared with; and their
reports."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from moireaug.evaluation import paired_gain, report
from moireaug.evaluation.examples import run_examples, table_examples
from moireaug.evaluation.frame import MEASURES
from moireaug.evaluation.suites.ladder import main_attack
from moireaug.files import write_text
from moireaug.mixtures import scenes_of
from training.attack.protocol import AttackResult
from training.attack.subject import Subject
from training.config.schema import Config, ReattackConfig, scene_of
from training.runs.identity import fingerprint_of, result_settings
from training.system import machine

# metrics of the start in metrics.json, and those of the baseline, which is attacked too
START_KEYS = ("recipe", "seed", "data", "model", "train")
BASELINE_KEYS = (*START_KEYS, "clean_accuracy", "reattack")
Metrics = dict[str, Any]


def ladder_metrics(result: AttackResult) -> Metrics:
    """Return the metrics of a ladder, with every image's outcome as a string of 0 and 1 for paired
    comparisons."""
    rows, outcomes = [], {}
    for cell in result.cells.to_dict("records"):
        row = {name: cell[name] for name in ("eps", "steps", "control", "targeted", "accuracy")}
        row = {"name": cell["row"]} | row
        row["accuracy_interval"] = [cell["accuracy_low"], cell["accuracy_high"]]
        row["success"] = None if pd.isna(cell["success"]) else cell["success"]
        row["success_interval"] = [cell["low"], cell["high"]]
        for name in ("n", "counted", "undecided", "seconds"):
            row[name] = cell[name]
        for name in MEASURES:
            if not pd.isna(cell[name]):
                row[name] = cell[name]
        rows.append(row)
        outcomes[cell["row"]] = cell["outcomes"]
    return {
        "clean_accuracy": rows[0]["accuracy"],
        "reattack": rows,
        "correct": outcomes,
        "identity": result.runner.name,
        **result.checks,
    }


def run_metrics(
    cfg: Config,
    own_metrics: Mapping[str, Any],
    train: Mapping[str, Any] | None,
    start: Mapping[str, Any] | None,
    baseline: Mapping[str, Any] | None,
) -> Metrics:
    """Return the metrics of a run: its own, those of the runs beside it, and its gain.

    Args:
        cfg: settings of the run.
        own_metrics: metrics of its ladder; empty where it was not attacked.
        train: cost of its training; None where it was not trained here.
        start: metrics of the run whose weights it started from.
        baseline: metrics of plain training of at least as many epochs in all, over which the gain
            is measured.
    """
    metrics = {
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "train": train,
        **own_metrics,
        **run_facts(cfg),
        "start": _shared(start, START_KEYS),
        "baseline": _shared(baseline, BASELINE_KEYS),
        "gain": {},
        "gain_interval": {},
    }
    if baseline:
        metrics |= gains(metrics["correct"], baseline["correct"])
    return metrics


def run_facts(cfg: Config) -> Metrics:
    """Return a report's facts on its run: scene, settings, machine and command."""
    scene, settings = scene_of(cfg), result_settings(cfg)
    return {
        "scene_name": scene_title(cfg.scene),
        "scene": scene.to_dict(),
        "plan": "\n\n".join(str(one.plan()) for one in scenes_of(scene)),
        "config": settings,
        "fingerprint": fingerprint_of(settings),
        "environment": machine.environment(cfg.trainer.accelerator),
        "command": machine.command(),
    }


def scene_title(scene: Any) -> str:
    """Return the title of a scene, given as in the settings: the names of its presets."""
    names = scene if isinstance(scene, (list, tuple)) else [scene]
    return ", ".join(names) if all(isinstance(name, str) for name in names) else "custom"


def gains(ours: Mapping[str, str], theirs: Mapping[str, str]) -> Metrics:
    """Return the gain in accuracy over a baseline and its interval, by rung, from every image's
    outcome."""
    gain, interval = {}, {}
    for name in ours:
        if name in theirs:
            gain[name], low, high = paired_gain(_outcomes(ours[name]), _outcomes(theirs[name]))
            interval[name] = [low, high]
    return {"gain": gain, "gain_interval": interval}


def _outcomes(text: str) -> torch.Tensor:
    return torch.tensor([outcome == "1" for outcome in text], device="cpu")


def _shared(metrics: Mapping[str, Any] | None, keys: Sequence[str]) -> Metrics | None:
    """Return the part of a run's metrics that is copied into those of a run beside it."""
    if not metrics:
        return None
    part = {key: metrics[key] for key in keys}
    if "environment" in metrics:
        part["environment"] = metrics["environment"]
    return part


def publish(
    out: Path,
    metrics: Metrics,
    results: Mapping[str, AttackResult],
    classes: Mapping[int, str],
    seconds: Mapping[str, float],
) -> Metrics:
    """Write report.html, then metrics.json, and print the summary; return the metrics with their
    times.

    Args:
        out: folder of the report.
        metrics: metrics of the run.
        results: results by name, for the pictures; the run's own come first.
        classes: names of the classes.
        seconds: time spent, by phase.
    """
    own_result = next(iter(results.values()))
    runners = {name: result.runner for name, result in results.items()}
    metrics = metrics | {"time": dict(seconds)}
    examples = run_examples(runners, main_attack(own_result.tables[0]), classes)
    report.write_run(out / "report.html", metrics, examples)
    write_metrics(out, metrics)
    report.show(report.run_parts(metrics))
    print(f"Report: {out / 'report.html'}")
    return metrics


def write_metrics(out: Path, metrics: Metrics) -> Metrics:
    """Write metrics.json, which replaces train.json; return the metrics."""
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    (out / "train.json").unlink(missing_ok=True)
    return metrics


def publish_suite(cfg: ReattackConfig, subject: Subject, result: AttackResult) -> Metrics:
    """Write report.html, tables.md, results.csv and metrics.json of a suite, and print its
    summary."""
    out, protocol = subject.folder, subject.protocol
    tables = {}
    for name, cells in result.cells.groupby("table", sort=False):
        columns = cells.drop(columns="table").astype(object)
        tables[str(name)] = columns.where(columns.notna(), None).to_dict("records")
    metrics = {
        "suite": cfg.suite,
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "n": protocol.batches.n,
        "steps": protocol.settings.steps,
        "eps": protocol.config().middle,
        "identity": result.runner.name,
        **result.checks,
        "tables": tables,
        "time": {**subject.seconds, **result.seconds},
        **run_facts(cfg),
    }
    examples = {}
    for table in result.tables:
        examples[table.name] = table_examples(
            table, result.runner, subject.splits.classes, subject.name
        )
    summary = report.write_suite(out, metrics, result.tables, result.cells, examples)
    write_metrics(out, metrics)
    report.show(summary)
    print(f"Report: {out / 'report.html'}")
    return metrics
