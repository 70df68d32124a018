"""The results of an attack: described, compared with the runs beside it, and published."""

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
from training.attack.protocol import Attacked
from training.attack.subject import Subject
from training.config.schema import Config, ReattackConfig, scene_of
from training.runs.run import fingerprint_of, result_settings
from training.system import machine

# what metrics.json says of the start, and of the baseline, which is attacked too
START = ("recipe", "seed", "data", "model", "train")
BASELINE = (*START, "clean_accuracy", "reattack")
Metrics = dict[str, Any]


def describe(attacked: Attacked) -> Metrics:
    """Return the ladder as plain values, with every image's outcome as a string of 0 and 1, for
    paired comparisons."""
    rows, outcomes = [], {}
    for line in attacked.lines.to_dict("records"):
        row = {name: line[name] for name in ("eps", "steps", "control", "targeted", "accuracy")}
        row = {"name": line["row"]} | row
        row["accuracy_interval"] = [line["accuracy_low"], line["accuracy_high"]]
        row["success"] = None if pd.isna(line["success"]) else line["success"]
        row["success_interval"] = [line["low"], line["high"]]
        for name in ("n", "counted", "undecided", "seconds"):
            row[name] = line[name]
        for name in MEASURES:
            if not pd.isna(line[name]):
                row[name] = line[name]
        rows.append(row)
        outcomes[line["row"]] = line["outcomes"]
    return {
        "clean_accuracy": rows[0]["accuracy"],
        "reattack": rows,
        "correct": outcomes,
        "identity": attacked.runner.name,
        **attacked.checks,
    }


def compare(
    cfg: Config,
    described: Mapping[str, Any],
    train: Mapping[str, Any] | None,
    start: Mapping[str, Any] | None,
    baseline: Mapping[str, Any] | None,
) -> Metrics:
    """Return the metrics of a run: its own figures, those of the runs beside it, and what it
    gained.

    Args:
        described: the run's own figures; empty where it was not attacked.
        train: what its training cost, where it was trained here.
        start: metrics of the run whose weights it started from. baseline: metrics of the plainly
            trained run, of at least as many epochs in all, over which the gain is measured.
    """
    metrics = {
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "train": train,
        **described,
        **about(cfg),
        "start": _shared(start, START),
        "baseline": _shared(baseline, BASELINE),
        "gain": {},
        "gain_interval": {},
    }
    if baseline:
        metrics |= gains(metrics["correct"], baseline["correct"])
    return metrics


def about(cfg: Config) -> Metrics:
    """Return what a report says about how it was run."""
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
    """Return the name of a scene, as in the schema, for a reader: those of its presets."""
    names = scene if isinstance(scene, (list, tuple)) else [scene]
    return ", ".join(names) if all(isinstance(name, str) for name in names) else "custom"


def gains(ours: Mapping[str, str], theirs: Mapping[str, str]) -> Metrics:
    """Return the gain in accuracy and its interval, by rung, from every image's outcome."""
    gain, interval = {}, {}
    for name in ours:
        if name in theirs:
            gain[name], low, high = paired_gain(_outcomes(ours[name]), _outcomes(theirs[name]))
            interval[name] = [low, high]
    return {"gain": gain, "gain_interval": interval}


def _outcomes(text: str) -> torch.Tensor:
    return torch.tensor([outcome == "1" for outcome in text], device="cpu")


def _shared(known: Mapping[str, Any] | None, keys: Sequence[str]) -> Metrics | None:
    """Return what a run's metrics say of a run beside it."""
    if not known:
        return None
    shared = {key: known[key] for key in keys}
    if "environment" in known:
        shared["environment"] = known["environment"]
    return shared


def publish(
    out: Path,
    metrics: Metrics,
    attacked: Mapping[str, Attacked],
    classes: Mapping[int, str],
    seconds: Mapping[str, float],
) -> Metrics:
    """Write report.html, then metrics.json, and print the summary. Returns the metrics with what
    was added.

    Args:
        attacked: results by name, for the pictures; the run's own come first.
        seconds: spent, by phase.
    """
    own = next(iter(attacked.values()))
    runners = {name: one.runner for name, one in attacked.items()}
    metrics = metrics | {"time": dict(seconds)}
    shown = run_examples(runners, main_attack(own.tables[0]), classes)
    report.write_run(out / "report.html", metrics, shown)
    write_metrics(out, metrics)
    report.show(report.run_parts(metrics))
    print(f"Report: {out / 'report.html'}")
    return metrics


def write_metrics(out: Path, metrics: Metrics) -> Metrics:
    """Write metrics.json, which replaces what training has left; return the metrics."""
    write_text(out / "metrics.json", json.dumps(metrics, indent=1))
    (out / "train.json").unlink(missing_ok=True)
    return metrics


def publish_suite(cfg: ReattackConfig, subject: Subject, attacked: Attacked) -> Metrics:
    """Write report.html, tables.md, results.csv and metrics.json of a suite, and print its
    summary."""
    out, protocol = subject.folder, subject.protocol
    tables = {}
    for name, lines in attacked.lines.groupby("table", sort=False):
        known = lines.drop(columns="table").astype(object)
        tables[str(name)] = known.where(known.notna(), None).to_dict("records")
    metrics = {
        "suite": cfg.suite,
        "recipe": cfg.recipe,
        "seed": cfg.seed,
        "data": cfg.data.name,
        "model": cfg.model,
        "n": protocol.batches.n,
        "steps": protocol.settings.steps,
        "eps": protocol.config().middle,
        "identity": attacked.runner.name,
        **attacked.checks,
        "tables": tables,
        "time": {**subject.seconds, **attacked.seconds},
        **about(cfg),
    }
    shown = {}
    for table in attacked.tables:
        shown[table.name] = table_examples(
            table, attacked.runner, subject.splits.classes, subject.name
        )
    short = report.write_suite(out, metrics, attacked.tables, attacked.lines, shown)
    write_metrics(out, metrics)
    report.show(short)
    print(f"Report: {out / 'report.html'}")
    return metrics
