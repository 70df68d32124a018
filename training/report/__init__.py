"""Reports: one self-contained HTML page, Markdown, CSV, and a short form for the terminal."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from moireaug.common.files import write_text
from moireaug.evaluation.tables import Table
from training.report import page, plots
from training.report.run_view import run_view
from training.report.suite_view import suite_view
from training.report.terminal import parts_of_run, suite_parts
from training.runs.layout import REPORT
from training.runs.metrics import RunMetrics, SuiteMetrics

__all__ = ["run_parts", "suite_parts", "write_run", "write_suite"]

Examples = list[dict[str, Any]]
QUANTITIES = (
    plots.Quantity(
        "training loss, nats", "Training loss, epoch by epoch.", {"loss": ""}, limits=(0, None)
    ),
    plots.Quantity(
        "validation accuracy, %",
        "Accuracy on validation images, epoch by epoch: solid on clean images, dashed under the "
        "adversary that the recipe trains against.",
        {"clean": "clean", "perturbed": "attacked"},
        scale=100,
        limits=(0, 100),
    ),
)


def run_parts(metrics: RunMetrics) -> list[str]:
    """Return the short form of a run's report for the terminal."""
    return parts_of_run(metrics, run_view(metrics))


def write_run(path: Path, metrics: RunMetrics, examples: Examples) -> list[str]:
    """Write the report of a run, and return its short form for the terminal; an older one is
    replaced only once the new one is complete.

    Args:
        examples: blocks of pictures: {"label", "cells"} each; a cell is {"title", "image": (H, W,
            3) uint8} and, where models have answered, "predictions": [(model, class, right)].
    """
    facts = {name: getattr(metrics, name) for name in ("data", "model", "seed")}
    run = run_view(metrics)
    text = page.render(
        "run.html.j2",
        run=run,
        metrics=metrics,
        facts=facts | {"scene": metrics.scene_name},
        examples=examples,
        curves=_curves(metrics),
        tradeoff=plots.scatter(run["visibility"], "PSNR of the noise, dB", "accuracy, %"),
    )
    write_text(path, text)
    return parts_of_run(metrics, run)


def write_suite(
    folder: Path,
    metrics: SuiteMetrics,
    tables: Sequence[Table],
    lines: pd.DataFrame,
    examples: Mapping[str, Examples],
) -> list[str]:
    """Write report.html, tables.md and results.csv into a folder; returns the short form for the
    terminal.

    Args:
        lines: their rates, as `frame.rates` gives them.
        examples: name of a table to blocks of pictures, as `write_run` takes them.
    """
    suite = suite_view(metrics, tables, lines, examples)
    facts = {
        name: getattr(metrics, name) for name in ("data", "model", "suite", "n", "steps", "bound")
    }
    unused = ["outcomes"]
    if lines["lpips"].isna().all():
        unused.append("lpips")
    results = lines.drop(columns=unused).to_csv(index=False, float_format="%.6g")
    write_text(folder / "results.csv", results)
    context = {"suite": suite, "metrics": metrics, "facts": facts | {"scene": metrics.scene_name}}
    write_text(folder / "tables.md", page.render("suite.md.j2", **context))
    write_text(folder / REPORT, page.render("suite.html.j2", **context))
    return suite_parts(metrics, suite)


def _curves(metrics: RunMetrics) -> list[dict[str, str]]:
    """Return the plots of a training, with captions and alternative texts; none where it was not
    trained here."""
    histories = {}
    for side in (metrics, metrics.baseline):
        if side and side.train:
            rows, best = side.train.history, side.train.best_epoch
            epochs = [row["epoch"] + 1 for row in rows]
            histories[page.name_of(side)] = plots.History(epochs, rows, best + 1)
    return plots.curves(histories, "epoch", QUANTITIES) if histories else []
