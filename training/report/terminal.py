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
    data, model, scene = (short(one, FACT_WIDTH) for one in (metrics.data, metrics.model, scene))
    n = run["main"]["n"]
    facts = f"{data}, {model}, {scene}{comma}{shrink}, n = {n}, accuracy in %, eps in 1/255"
    sides = [short(side["name"], NAME_WIDTH) for side in run["sides"]]
    heads = ["", "eps", "codes", "dB", *sides, "gain [95 %]" if run["baseline"] else "95 %"]
    rows = [_ladder_row(row) for row in run["rows"]]
    below = render("run_lines.j2", run=run).splitlines()
    return [facts, aligned([heads, *rows]), *(line for line in below if line.strip())]


def _ladder_row(row: Mapping[str, Any]) -> list[str]:
    cells = [short(row["title"], TITLE_WIDTH), eps_with_unit(row), "", ""]
    if row["psnr"] is not None:
        cells[2:] = codes(row["largest"]), number(row["psnr"])
    for side in row["sides"].values():
        cells.append(percent(side["accuracy"].value))
    if gain := row["gain"]:
        cells.append(f"{points(gain.value)} [{points(gain.low)}, {points(gain.high)}]")
    else:
        ours = row["sides"]["ours"]["accuracy"]
        cells.append(f"{percent(ours.low)} – {percent(ours.high)}")
    return cells


def suite_parts(metrics: SuiteMetrics, suite: Mapping[str, Any]) -> list[str]:
    """Return a suite's tables: success in %, one line per row."""
    parts: list[str] = []
    for table in suite["tables"]:
        if parts:
            parts.append("")
        parts += [f"{table['title']}: fooled, %", _suite_table(table)]
        if table["moire"]:
            parts.append(f"moiré, photo minus the same without: {table['moire']}")
    if suite["unanswered"]:
        parts += ["", render("unanswered.j2", unanswered=suite["unanswered"])]
    if metrics.trust:
        parts += ["", "Can it be trusted?"]
        for check in metrics.trust:
            parts.append(f"  {check['verdict']:8}{check['name']}: {check['says']}")
    return parts


def _suite_table(table: Mapping[str, Any]) -> str:
    rows = [["", *(title_of(column, "columns") for column in table["columns"])]]
    for row in table["rows"]:
        rates = [percent(cell and cell["success"]) for cell in row["cells"]]
        rows.append([title_of(row["name"], "rows"), *rates])
    return aligned(rows)
