"""Reports for the terminal, in at most 100 columns where the names allow it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from moireaug.evaluation.report.numbers import codes, duration, number, percent, points, short
from moireaug.evaluation.report.page import render, title_of
from moireaug.evaluation.report.run_view import Metrics, Rate, run_view

TITLE, NAME = 27, 10


def grid(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of texts as aligned lines, the first column to the left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        for text, width in zip(row[1:], widths[1:], strict=True):
            cells.append(text.rjust(width))
        lines.append("  ".join(cells))
    return lines


def run_summary(metrics: Metrics) -> str:
    """Return the ladder as a table: accuracy of the start, the baseline and this model, and the
    gain over the baseline; of an attack how far its noise moves the photo."""
    run = run_view(metrics)
    facts = [
        short(str(metrics[name]), 18)
        for name in ("data", "model", "scene_name")
        if metrics.get(name)
    ]
    facts.append(f"n = {run['n']}" if run["rows"] else "not attacked")
    lines = [", ".join([*facts, "accuracy in %, eps in 1/255"])]
    if run["rows"]:
        lines += grid([_head(run), *[_line(run, row) for row in run["rows"]]])
    if run["noise"]:
        lines.append(
            "codes, dB: largest change of a code of 255, and PSNR, by the noise against this model"
        )
    lines += _training(run)
    if run["unanswered"]:
        lines.append(render("unanswered.j2", found=run["unanswered"]))
    return "\n".join(lines)


def _head(run: dict[str, Any]) -> list[str]:
    heads = ["", "eps"]
    if run["noise"]:
        heads += ["codes", "dB"]
    for side in run["sides"]:
        heads.append(short(side["name"], NAME))
    heads.append("gain [95 %]" if run["baseline"] else "95 %")
    return heads


def _line(run: dict[str, Any], row: dict[str, Any]) -> list[str]:
    line = [short(row["title"], TITLE), codes(row["eps"])]
    if run["noise"]:
        line += _noise(row)
    for side in run["sides"]:
        line.append(percent(row["sides"][side["kind"]]["accuracy"].value))
    if run["baseline"]:
        line.append(points(row["gain"].value) + _ends(row["gain"]))
    else:
        line.append(_span(row["sides"]["ours"]["accuracy"]))
    return line


def _noise(row: dict[str, Any]) -> list[str]:
    """Return how far an attack's noise moves the photo; of a control nothing."""
    if row["psnr"] is None:
        return ["", ""]
    return [codes(row["largest"]), number(row["psnr"])]


def _span(rate: Rate) -> str:
    if rate.low is None:
        return ""
    return f"{percent(rate.low)} – {percent(rate.high)}"


def _ends(gain: Rate) -> str:
    if gain.low is None:
        return ""
    return f" [{points(gain.low)}, {points(gain.high)}]"


def _training(run: dict[str, Any]) -> list[str]:
    """Return what training took, with the weights that it started from."""
    if run["seconds"] is None:
        return []
    text = f"training: {short(run['name'], 20)} {duration(run['seconds'])}"
    if run["start"]:
        text += " with its start"
    if run["seconds_theirs"]:
        ratio = run["seconds"] / run["seconds_theirs"]
        text += f", {ratio:.1f} times its baseline's {duration(run['seconds_theirs'])}"
    return [text]


def suite_summary(metrics: Metrics, suite: dict[str, Any]) -> str:
    """Return a suite's tables: success in %, one line a row."""
    lines = []
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
        lines += ["", f"{title_of(table['name'], 'tables')}: fooled, %", *grid(rows)]
    if suite["unanswered"]:
        lines += ["", render("unanswered.j2", found=suite["unanswered"])]
    if metrics.get("trust"):
        lines += ["", "Can it be trusted?"]
        for check in metrics["trust"]:
            lines.append(f"  {check['verdict']:8}{check['name']}: {check['says']}")
    return "\n".join(lines).strip("\n")
