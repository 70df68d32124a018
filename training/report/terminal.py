"""Reports for the terminal, in at most 100 columns where the names allow it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from training.report.numbers import codes, eps_with_unit, number, percent, points, short
from training.report.page import render, title_of
from training.report.run_view import run_view
from training.runs.metrics import RunMetrics, SuiteMetrics

TITLE_WIDTH, NAME_WIDTH = 27, 10


class Grid(NamedTuple):
    """A table of texts: the first row is the head, and the first column is aligned to the left."""

    rows: Sequence[Sequence[str]]
    title: str = ""


Part = str | Grid


def show(parts: Sequence[Part]) -> None:
    """Print to standard output."""
    print(plain(parts))


def plain(parts: Sequence[Part]) -> str:
    """Return the parts as plain text."""
    lines: list[str] = []
    for part in parts:
        if isinstance(part, str):
            lines.append(part)
            continue
        lines += [part.title] if part.title else []
        lines += _aligned(part.rows)
    return "\n".join(lines)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *cells[1:]]))
    return lines


def run_parts(metrics: RunMetrics) -> list[Part]:
    """Return the ladder as a table: accuracy of the baseline and of this model, and the gain; for
    attacks also how far the noise moves the photo."""
    run = run_view(metrics)
    scene, *shrink = metrics.scene_name.split(", shrink ")  # which is not cut
    facts = [short(name, 18) for name in (metrics.data, metrics.model, scene)]
    facts += [f"shrink {text}" for text in shrink]
    facts += [f"n = {run['main']['n']}", "accuracy in %, eps in 1/255"]
    heads = ["", "eps", "codes", "dB"]
    heads += [short(side["name"], NAME_WIDTH) for side in run["sides"]]
    heads.append("gain [95 %]" if run["baseline"] else "95 %")
    lines = [_line(run, row) for row in run["rows"]]
    text = render("run_lines.j2", run=run)
    below = [line for line in text.splitlines() if line.strip()]
    return [", ".join(facts), Grid([heads, *lines]), *below]


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
