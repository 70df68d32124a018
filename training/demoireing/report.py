"""The report of a test: a page, plots of the training, and lines for the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from moireaug.evaluation.visibility import SSIM_WINDOW
from training.demoireing.testing import GroupedPair
from training.report.numbers import number
from training.report.page import picture_cells, render
from training.report.plots import History, Quantity, curves
from training.report.terminal import aligned

REMOVED_AMPLIFICATION = 4  # factor of the removed part in a picture
Row = Mapping[str, Any]

# columns of the table: a reference, and the prefix of the names of its measures
REFERENCE_COLUMNS = {
    "the twin": ("twin", ""),
    "the original": ("original", ""),
    "the original, colours mapped": ("original", "mapped_"),
}
# measures under each reference, and decimals of their figures
MEASURE_DIGITS = {"psnr": 2, "ssim": 3}


def page(metrics: Mapping[str, Any], examples: Sequence[tuple[GroupedPair, Tensor]]) -> str:
    """Return the report of a run as a self-contained page.

    Args:
        examples: pairs of the report, and their cleaned photos.
    """
    lead = [main_figures(metrics, kind) for kind in ("seen", "unseen", "real")]
    return render(
        "demoireing.html.j2",
        title=f"{metrics['model']}, trained on simulated pairs alone",
        lead=[figures for figures in lead if figures["n"]],
        facts={name: metrics[name] for name in ("data", "model", "width", "target", "seed")},
        columns=list(REFERENCE_COLUMNS),
        rows=table_rows(metrics["test"]),
        examples=[example_block(pair, cleaned) for pair, cleaned in examples],
        curves=training_curves(metrics["train"]),
        metrics={**metrics, "scene": None, "plan": None},
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
    figures = {"kind": kind, "reference": reference, "measure": measure}
    rows = [row for row in metrics["test"] if figures.items() <= row.items()]
    n = sum(row["n"] for row in rows)
    for side in ("before", "after"):
        figures[side] = sum(row[side] * row["n"] for row in rows) / max(n, 1)
    return figures | {"n": n, "gained": sum(row["gained"] for row in rows)}


def table_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return one row per group, with a cell for PSNR and SSIM under each of `REFERENCE_COLUMNS`;
    None where there is no such reference."""
    groups: dict[str, dict[tuple[str, str], Row]] = {}
    for row in rows:
        groups.setdefault(row["group"], {})[row["reference"], row["measure"]] = row
    table = []
    for measured in groups.values():
        cells = []
        for reference, prefix in REFERENCE_COLUMNS.values():
            for measure, digits in MEASURE_DIGITS.items():
                figures = measured.get((reference, prefix + measure))
                cells.append(figures and cell_text(figures, digits))
        table.append({**next(iter(measured.values())), "cells": cells})
    return table


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


def terminal_parts(metrics: Mapping[str, Any]) -> list[str]:
    """Return the figures for a terminal: PSNR in dB and SSIM, before and after."""
    lines = [["pairs", "n", "against", "PSNR, dB", "gain", "twin", "SSIM"]]
    for row in table_rows(metrics["test"]):
        group = row["group"] if row["kind"] == "real" else f"{row['group']} ({row['kind']})"
        pairs_of_cells = zip(row["cells"][::2], row["cells"][1::2], strict=True)
        for against, (psnr, ssim) in zip(REFERENCE_COLUMNS, pairs_of_cells, strict=True):
            if psnr is None:
                continue
            gain = psnr["gain"].split(" ")[0].rstrip(";")
            change, likeness = (f"{cell['before']} → {cell['after']}" for cell in (psnr, ssim))
            lines.append([group, str(row["n"]), against, change, gain, psnr["twin"], likeness])
            group = ""
    train = metrics["train"]
    cost = (
        f"training: {train['steps']} steps in {train['seconds']:.0f} s, "
        f"{train['pairs_per_second']:.1f} pairs per second; kept: step {train['best_steps']}"
    )
    return [aligned(lines), cost]


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
