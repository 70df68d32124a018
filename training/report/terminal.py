"""Reports for the terminal, in at most 100 columns where the names allow it."""

from collections.abc import Mapping, Sequence
from typing import Any

from training.report.numbers import codes, eps_with_unit, number, percent, points, short
from training.report.page import render, title_of
from training.runs.metrics import RunMetrics, SuiteMetrics

TITLE_WIDTH, NAME_WIDTH, FACT_WIDTH = 27, 10, 18  # characters


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return a table as text: the first row is its head, the first column is aligned to the left
    and the others to the right."""
    first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
    lines = []
    for name, *cells in rows:
        padded = [cell.rjust(width) for cell, width in zip(cells, others, strict=True)]
        lines.append("  ".join([name.ljust(first), *padded]))
    return "\n".join(lines)


def parts_of_run(metrics: RunMetrics, run: Mapping[str, Any]) -> list[str]:
    """Return the ladder of a view of a run as a table: accuracy of the baseline and of this model,
    and the gain; for attacks also how far the noise moves the photo."""
    scene, comma, shrink = metrics.scene_name.partition(", shrink ")
    names = [short(name, FACT_WIDTH) for name in (metrics.data, metrics.model, scene)]
    n = run["main"]["n"]
    facts = f"{', '.join(names)}{comma}{shrink}, n = {n}, accuracy in %, eps in 1/255"
    sides = [short(side["name"], NAME_WIDTH) for side in run["sides"]]
    interval = "gain [95 %]" if run["baseline"] else "95 %"
    rows = [["", "eps", "codes", "dB", *sides, interval]]
    for row in run["rows"]:
        rows.append(_line(row))
    text = render("run_lines.j2", run=run)
    below = [line for line in text.splitlines() if line.strip()]
    return [facts, aligned(rows), *below]


def _line(row: Mapping[str, Any]) -> list[str]:
    """Return the cells of a row of the ladder."""
    largest = psnr = ""
    if row["psnr"] is not None:
        largest, psnr = codes(row["largest"]), number(row["psnr"])
    accuracies = [side["accuracy"] for side in row["sides"].values()]
    rates = [percent(accuracy.value) for accuracy in accuracies]
    interval = f"{percent(accuracies[0].low)} – {percent(accuracies[0].high)}"
    if gain := row["gain"]:
        interval = f"{points(gain.value)} [{points(gain.low)}, {points(gain.high)}]"
    return [short(row["title"], TITLE_WIDTH), eps_with_unit(row), largest, psnr, *rates, interval]


def suite_parts(metrics: SuiteMetrics, suite: Mapping[str, Any]) -> list[str]:
    """Return a suite's tables: success in %, one line per row."""
    parts: list[str] = []
    for table in suite["tables"]:
        rows = [["", *(title_of(column, "columns") for column in table["columns"])]]
        for row in table["rows"]:
            rates = [percent(cell and cell["success"]) for cell in row["cells"]]
            rows.append([title_of(row["name"], "rows"), *rates])
        if parts:
            parts.append("")
        parts += [f"{table['title']}: fooled, %", aligned(rows)]
        if table["moire"]:
            parts.append(f"moiré, photo minus the same without: {table['moire']}")
    if suite["unanswered"]:
        parts += ["", render("unanswered.j2", unanswered=suite["unanswered"])]
    if metrics.trust:
        parts += ["", "Can it be trusted?"]
        for check in metrics.trust:
            parts.append(f"  {check['verdict']:8}{check['name']}: {check['says']}")
    return parts
