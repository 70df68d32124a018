"""The report of a test: a page, plots of the training, and lines for the terminal."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from moireaug.evaluation.visibility import SSIM_WINDOW
from training.demoireing.testing import GroupedPair
from training.report.numbers import number
from training.report.page import environment, picture_cells
from training.report.plots import History, Quantity, curves
from training.report.terminal import Grid, Part

TEMPLATE = Path(__file__).with_name("report.html.j2")
REMOVED_AMPLIFICATION = 4  # factor of the removed part in a picture
Row = Mapping[str, Any]

# columns of the table: a reference, and the prefix of the names of its measures
REFERENCE_COLUMNS = {
    "the twin": ("twin", ""),
    "the original": ("original", ""),
    "the original, colours mapped": ("original", "mapped_"),
}


def page(metrics: Mapping[str, Any], examples: Sequence[tuple[GroupedPair, Tensor]]) -> str:
    """Return the report of a run as a self-contained page.

    Args:
        examples: pairs of the report, and their cleaned photos.
    """
    lead = [main_figures(metrics, kind) for kind in ("seen", "unseen", "real")]
    time = {name: value for name, value in metrics["time"].items() if value is not None}
    template = environment().overlay(autoescape=True).from_string(TEMPLATE.read_text("utf-8"))
    return template.render(
        title=f"{metrics['model']}, trained on simulated pairs alone",
        lead=[figures for figures in lead if figures["n"]],
        facts={name: metrics[name] for name in ("data", "model", "width", "target", "seed")},
        columns=list(REFERENCE_COLUMNS),
        rows=table_rows(metrics["test"]),
        examples=[example_block(pair, cleaned) for pair, cleaned in examples],
        curves=training_curves(metrics["train"]),
        time=time,
        metrics={**metrics, "scene": None, "plan": None},
        target=metrics["target"],
        window=SSIM_WINDOW,
    )


def main_figures(metrics: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """Return the figures that tell whether a network meets its target on the photos of a kind, the
    means of their groups: PSNR against a `reference`, its colours mapped or not."""
    reference, measure = "original", "mapped_psnr"
    if metrics["target"] == "original":
        measure = "psnr"
    elif metrics["target"] == "twin" and kind != "real":
        reference, measure = "twin", "psnr"
    wanted = {"kind": kind, "reference": reference, "measure": measure}
    rows = [row for row in metrics["test"] if wanted.items() <= row.items()]
    n = sum(row["n"] for row in rows)
    before, after = (
        sum(row[k] * row["n"] for row in rows) / max(n, 1) for k in ("before", "after")
    )
    gained = sum(row["gained"] for row in rows)
    return {**wanted, "n": n, "before": before, "after": after, "gained": gained}


def table_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return one row per group, with a cell for PSNR and SSIM under each of `REFERENCE_COLUMNS`;
    None where there is no such reference."""
    by_group: dict[str, dict[str, Any]] = {}
    for row in rows:
        labels = {k: row[k] for k in ("group", "kind", "n", "milliseconds", "megapixels")}
        by_group.setdefault(row["group"], labels | {"cells": [None] * 2 * len(REFERENCE_COLUMNS)})
        for column, (reference, prefix) in enumerate(REFERENCE_COLUMNS.values()):
            for side, name in enumerate(("psnr", "ssim")):
                if (row["reference"], row["measure"]) == (reference, prefix + name):
                    by_group[row["group"]]["cells"][2 * column + side] = cell_text(row, 2 + side)
    return list(by_group.values())


def cell_text(row: Row, digits: int) -> dict[str, str]:
    """Return a row's figures as they are printed."""
    gain = f"{row['gain']:+.{digits}f}"
    if row["gain_interval"]:
        low, high = row["gain_interval"]
        gain += f" ({low:+.{digits}f} to {high:+.{digits}f})"
    return {
        "before": number(row["before"], digits),
        "after": number(row["after"], digits),
        "gain": f"{gain}; {row['gained']} of {row['n']}".replace("-", "−"),
        "twin": "" if row["twin"] is None else number(row["twin"], digits),
    }


def terminal_parts(metrics: Mapping[str, Any]) -> list[Part]:
    """Return the figures for a terminal: PSNR in dB and SSIM, before and after."""
    rows = [["pairs", "n", "against", "PSNR, dB", "gain", "twin", "SSIM"]]
    for row in table_rows(metrics["test"]):
        group = f"{row['group']} ({row['kind']})" if row["kind"] != "real" else row["group"]
        for column, against in enumerate(REFERENCE_COLUMNS):
            psnr, ssim = row["cells"][2 * column : 2 * column + 2]
            if psnr is None:
                continue
            change = f"{psnr['before']} → {psnr['after']}"
            gain = psnr["gain"].split(" ")[0].rstrip(";")
            likeness = f"{ssim['before']} → {ssim['after']}"
            rows.append([group, str(row["n"]), against, change, gain, psnr["twin"], likeness])
            group = ""
    train = metrics["train"]
    cost = (
        f"training: {train['steps']} steps in {train['seconds']:.0f} s, "
        f"{train['pairs_per_second']:.1f} pairs per second; kept: step {train['best_steps']}"
    )
    return [Grid(rows), cost]


def example_block(pair: GroupedPair, cleaned: Tensor) -> dict[str, Any]:
    """Return the pictures of a pair, side by side."""
    removed = 128 + REMOVED_AMPLIFICATION * (pair.photo.int() - cleaned.int())
    sides = {
        "photo": pair.photo,
        "cleaned": cleaned,
        "twin": pair.twin,
        "original": pair.original,
        f"removed × {REMOVED_AMPLIFICATION}": removed.clamp(0, 255).byte(),
    }
    return {"label": f"{pair.group}: {pair.name}", "cells": picture_cells(sides)}


def training_curves(train: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the plots of a training: its loss, and PSNR on the pairs that validate."""
    rows, best = train["history"], train["best_steps"]
    history = History([row["steps"] for row in rows], rows, best)
    loss = Quantity("training loss", "Training loss, mean since the last validation.", {"loss": ""})
    psnr = Quantity(
        "validation PSNR, dB",
        f"PSNR of validation photos. The ring marks step {best}, which was kept.",
        {"psnr": "cleaned photos", "photo_psnr": "the photos themselves"},
    )
    return curves({"": history}, "step", (loss, psnr))
