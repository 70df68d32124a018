"""Reports: one self-contained HTML page, Markdown, CSV, and a short form for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from moireaug.evaluation.tables import Table
from moireaug.files import write_text
from training.report import page, plots
from training.report.metrics import name_of
from training.report.numbers import finite
from training.report.run_view import run_view
from training.report.suite_view import suite_view
from training.report.terminal import Part, run_parts, show, suite_parts

__all__ = ["run_parts", "show", "suite_parts", "write_run", "write_suite"]

Examples = list[dict[str, Any]]


def write_run(path: Path, metrics: Mapping[str, Any], examples: Examples | None = None) -> None:
    """Write the report of a run; an older one is replaced only once the new one is complete.

    Args:
        path: of the page; its folder is created if missing.
        metrics: content of `metrics.json`. Entries may be missing; None and NaN stand for unknown.
        examples: blocks of pictures: {"label", "cells"} each; a cell is {"title", "image": (H, W,
            3) uint8} and, where models have answered, "predictions": [(model, class, right)].

    Raises:
        ValueError: a picture that is not (H, W, 3) uint8.
    """
    run = run_view(metrics)
    facts = {"data": metrics.get("data"), "model": metrics.get("model")}
    facts |= {"scene": metrics.get("scene_name"), "seed": metrics.get("seed")}
    text = page.render(
        "run.html.j2",
        run=run,
        metrics=_OptionalMetrics(metrics),
        facts=facts,
        examples=examples or [],
        curves=_curves(metrics),
        phases=_phases(metrics),
    )
    write_text(path, text)


def write_suite(
    folder: Path,
    metrics: Mapping[str, Any],
    tables: Sequence[Table],
    lines: pd.DataFrame,
    examples: Mapping[str, Examples],
) -> list[Part]:
    """Write report.html, tables.md and results.csv into a folder; returns the short form for the
    terminal, which `show` prints.

    Args:
        metrics: of the evaluation: model, suite, data, scene, steps, n, trust, time, plan,
            environment, command.
        tables: tables of the suite.
        lines: their rates, as `frame.rates` gives them.
        examples: name of a table to blocks of pictures, as `write_run` takes them.
    """
    suite = suite_view(metrics, tables, lines, examples)
    facts = {name: metrics.get(name) for name in ("data", "model", "suite", "n", "steps")}
    facts["scene"] = metrics.get("scene_name")
    phases = _phases(metrics)
    unused = ["outcomes"]
    if lines["lpips"].isna().all():
        unused.append("lpips")
    results = lines.drop(columns=unused).to_csv(index=False, float_format="%.6g")
    write_text(folder / "results.csv", results)
    context = {"suite": suite, "metrics": _OptionalMetrics(metrics)}
    write_text(folder / "tables.md", page.render("suite.md.j2", **context))
    html = page.render("suite.html.j2", **context, facts=facts, phases=phases)
    write_text(folder / "report.html", html)
    return suite_parts(metrics, suite)


class _OptionalMetrics(dict[str, Any]):
    """Metrics whose missing entries are None for a template."""

    def __missing__(self, key: str) -> None:
        return None


def _curves(metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the plots of a training, with captions and alternative texts."""
    trains = {name_of(metrics): metrics.get("train")}
    baseline = metrics.get("baseline") or {}
    if baseline:
        trains[name_of(baseline)] = baseline.get("train")
    texts = (
        ("Training loss", "Training loss, epoch by epoch."),
        (
            "Validation accuracy",
            "Accuracy on validation images, epoch by epoch: solid on clean images, dashed under "
            "the adversary that the recipe trains against.",
        ),
    )
    figures = []
    for svg, (quantity, caption) in zip(plots.curves(trains), texts, strict=False):
        alt = f"{quantity} against the epoch, a line for {' and '.join(trains)}"
        uri = page.uri(svg.encode(), "image/svg+xml")
        figures.append({"uri": uri, "alt": alt, "caption": caption})
    return figures


def _phases(metrics: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the seconds of each phase that was timed, and their sum; None where nothing was."""
    parts = {}
    for name, value in (metrics.get("time") or {}).items():
        seconds = finite(value)
        if seconds is not None:
            parts[name] = seconds
    total = sum(parts.values())
    return {"parts": parts, "total": total} if total > 0 else None
