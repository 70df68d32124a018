"""Reports for the terminal, in at most 100 columns where the names allow it."""

import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from training.report.numbers import codes, eps_with_unit, number, percent, points, short
from training.report.page import render, title_of
from training.report.run_view import run_view
from training.runs.metrics import RunMetrics, SuiteMetrics
from training.system.messages import printable

TITLE_WIDTH, NAME_WIDTH = 27, 10


@dataclass(frozen=True)
class Grid:
    """A table of texts.

    Args:
        rows: the first one is the head. The first column is aligned to the left, others to the
            right.
        rule: number of rows below the head after which a line is drawn; 0 for none.
    """

    rows: Sequence[Sequence[str]]
    title: str = ""
    rule: int = 0


Part = str | Grid


def show(parts: Sequence[Part]) -> None:
    """Print to standard output, in characters that it can show; in a terminal wide enough for it, a
    table gets lines."""
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else 0
    print(printable(plain([_printable(part) for part in parts], columns)))


def _printable(part: Part) -> Part:
    """Return a part in characters that standard output can show."""
    if isinstance(part, str):
        return printable(part)
    rows = [[printable(cell) for cell in row] for row in part.rows]
    return Grid(rows, printable(part.title), part.rule)


def plain(parts: Sequence[Part], columns: int = 0) -> str:
    """Return the parts as plain text; a table that is at most so many columns wide gets lines
    around it, below its head and after its rule."""
    lines = []
    for part in parts:
        if isinstance(part, str):
            lines.append(part)
            continue
        if part.title:
            lines.append(part.title)
        rows = _aligned(part.rows)
        width = len(rows[0])
        if width <= columns:
            for place in sorted({0, 1, part.rule + 1, len(rows)}, reverse=True):
                rows.insert(place, "─" * width)
        lines += rows
    return "\n".join(lines)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        for text, width in zip(row[1:], widths[1:], strict=True):
            cells.append(text.rjust(width))
        lines.append("  ".join(cells))
    return lines


def run_parts(metrics: RunMetrics) -> list[Part]:
    """Return the ladder as a table: accuracy of the baseline and of this model, and the gain; for
    attacks also how far the noise moves the photo."""
    run = run_view(metrics)
    scene, *shrink = metrics.scene_name.split(", shrink ")  # which is not cut
    facts = [short(name, 18) for name in (metrics.data, metrics.model, scene)]
    facts += [f"shrink {text}" for text in shrink]
    facts += [f"n = {run['main']['n']}", "accuracy in %, eps in 1/255"]
    controls = [row for row in run["rows"] if not row["attack"]]
    heads = ["", "eps", "codes", "dB"]
    heads += [short(side["name"], NAME_WIDTH) for side in run["sides"]]
    heads.append("gain [95 %]" if run["baseline"] else "95 %")
    lines = [_line(run, row) for row in run["rows"]]
    text = render("run_lines.j2", run=run)
    below = [line for line in text.splitlines() if line.strip()]
    return [", ".join(facts), Grid([heads, *lines], rule=len(controls)), *below]


def _line(run: dict[str, Any], row: dict[str, Any]) -> list[str]:
    has_noise = row["psnr"] is not None
    line = [short(row["title"], TITLE_WIDTH), eps_with_unit(row)]
    line += [codes(row["largest"]), number(row["psnr"])] if has_noise else ["", ""]
    for side in row["sides"].values():
        line.append(percent(side["accuracy"].value))
    if run["baseline"]:
        gain = row["gain"]
        line.append(f"{points(gain.value)} [{points(gain.low)}, {points(gain.high)}]")
    else:
        accuracy = row["sides"]["ours"]["accuracy"]
        line.append(f"{percent(accuracy.low)} – {percent(accuracy.high)}")
    return line


def suite_parts(metrics: SuiteMetrics, suite: dict[str, Any]) -> list[Part]:
    """Return a suite's tables: success in %, one line per row."""
    parts: list[Part] = []
    for table in suite["tables"]:
        head = [""]
        for column in table["columns"]:
            head.append(title_of(column, "columns"))
        rows = [head]
        for row in table["rows"]:
            line = [title_of(row["name"], "rows")]
            for cell in row["cells"]:
                line.append(percent(None if cell is None else cell["success"]))
            rows.append(line)
        if parts:
            parts.append("")
        parts.append(Grid(rows, title=f"{title_of(table['name'], 'tables')}: fooled, %"))
        if table["moire"]:
            parts.append(f"moiré, photo minus the same without: {table['moire']}")
    if suite["unanswered"]:
        parts += ["", render("unanswered.j2", unanswered=suite["unanswered"])]
    if metrics.trust:
        parts += ["", "Can it be trusted?"]
        for check in metrics.trust:
            parts.append(f"  {check['verdict']:8}{check['name']}: {check['says']}")
    return parts
