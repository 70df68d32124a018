"""The report of a suite: the answer, the checks that failed, pictures, tables with plots, then every check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from moireaug.evaluation import grids, page, tables, words
from moireaug.evaluation.page import figure, section
from moireaug.evaluation.plots import facets
from moireaug.evaluation.store import write_text
from moireaug.evaluation.table import Table
from moireaug.evaluation.words import Metrics, duration, percent

Grid = tuple[Table, list[Metrics]]


def write(
    folder: Path,
    metrics: Metrics,
    results: Sequence[Grid],
    pictures: Mapping[str, Sequence[dict[str, Any]]],
) -> None:
    """Write report.html, tables.md and results.csv into a folder.

    Args:
        metrics: of the evaluation: model, suite, data, scene, steps, n, trust, time, plan, environment, command.
        results: each table with its tidy rows.
        pictures: name of a table to examples as `page.pictures` takes them.
    """
    write_text(folder / "results.csv", grids.to_csv([row for _, rows in results for row in rows]))
    write_text(folder / "tables.md", markdown(metrics, results))
    title, paragraphs = answer(metrics, results)
    sections = [tables.trust(metrics, only="fail")]
    sections += [section("Verdict: what is the moiré, what the noise", grids.verdicts_html(results))]
    explained = page.EXPLAINED
    for table, rows in results:
        wide, narrow = (facets(table, rows, narrow=n) for n in (False, True))
        says = f"Images fooled, row by row, one panel a column: {table.title}"
        shown = page.examples(pictures.get(table.name, ()))
        parts = [explained if shown else "", shown, grids.to_html(table, rows)]
        explained = "" if shown else explained  # once
        parts += [grids.visibility_html(table, rows), figure(wide, narrow, says, PLOT)]
        sections.append(section(table.title, *parts))
    sections += [tables.trust(metrics), section("Time", tables.phases(metrics)), page.made(metrics)]
    facts = {k: metrics.get(k) for k in ("data", "model", "suite", "n", "steps")} | {"scene": metrics["scene_name"]}
    page.write(folder / "report.html", title, facts, paragraphs, sections, how="suite_how.html")


PLOT = (
    "Images fooled, % of those right when clean, with 95 % intervals; one panel a column of the table. Grey panels are "
    "controls. A hollow diamond is the paper’s own figure, of another network and other images."
)


def answer(metrics: Metrics, results: Sequence[Grid]) -> tuple[str, list[str]]:
    """The title and the paragraphs under it."""
    name, said, checks = words.names(metrics)[0], [], metrics.get("trust") or []
    failed = [c["name"] for c in checks if c["verdict"] == "fail"]
    if failed:
        said.append(f"Checks that failed: {'; '.join(failed)}. The figures below may understate the attacker.")
    elif checks:
        warned = [c["name"] for c in checks if c["verdict"] == "warning"]
        text = f"None of {len(checks)} checks failed on {metrics['trust_n']} images"
        said.append(text + (f"; warnings: {'; '.join(warned)}." if warned else "."))
    first = next(((t, v) for t, rows in results if (v := grids.verdict(t, rows))), None)
    if first:
        said.insert(0, f"{first[0].title}. {first[1]} n = {first[1].counted} images that it has right.")
    said += [text for t, rows in results if (text := grids.natural(t, rows))]
    said += _unanswered(results)
    if not first:
        return f"{name}: {metrics['suite']}", said
    title = f"The Moiré Attack at {255 * first[1].eps:.3g}/255 fools {name} on {percent(first[1].attack, 0)} % of the "
    return title + f"images; its photo alone on {percent(first[1].photo, 0)} %", said


def _unanswered(results: Sequence[Grid]) -> list[str]:
    counts = {}  # a cell may stand in several tables
    for _, rows in results:
        for r in rows:
            counts[r["rung"], r["judge"]] = f"{r['row']}, {r['column']}", r["undecided"], r["n"]
    return words.unanswered(list(counts.values()))


def markdown(metrics: Metrics, results: Sequence[Grid]) -> str:
    """Every table as Markdown, with the verdicts and the checks."""
    lines = [f"# {words.names(metrics)[0]}, suite {metrics['suite']}", ""]
    took = duration(sum((metrics.get("time") or {}).values()))
    facts = f"{metrics['data']}, n = {metrics['n']}, {metrics['steps']} steps, scene {metrics['scene_name']}, {took}."
    note = "Images fooled, % of those right when clean, with 95 % intervals; the paper's figure in bold brackets."
    lines += [facts, "", f"    {metrics.get('command', '')}", "", note, ""]
    for table, rows in results:
        lines += [f"## {table.title}", "", grids.to_markdown(table, rows), ""]
        lines += [grids.visibility_markdown(table, rows), ""] if table.visible else []
        lines += [f"{text}\n" for text in (table.note, grids.verdict(table, rows), grids.natural(table, rows)) if text]
    lines += [f"{text}\n" for text in _unanswered(results)]
    if metrics.get("trust"):
        lines += ["## Can it be trusted?", "", "| check | | figures |", "|---|---|---|"]
        lines += [f"| {c['name']} | {c['verdict']} | {c['says']} |" for c in metrics["trust"]]
    return "\n".join(lines) + "\n"


def summary(metrics: Metrics, results: Sequence[Grid]) -> str:
    """The tables for the terminal: success in %, one line a row."""
    lines = []
    for table, rows in results:
        width = max(12, *(len(r) for r in table.rows))
        wide = [max(5, len(c)) + 2 for c in table.columns]
        heads = "".join(f"{c:>{w}}" for c, w in zip(table.columns, wide, strict=True))
        lines += ["", f"{table.title}: fooled, %", " " * width + heads]
        for row in table.rows:
            cells = (next((r for r in rows if (r["row"], r["column"]) == (row, c)), None) for c in table.columns)
            texts = ("–" if c is None else percent(c["success"]) for c in cells)
            lines.append(f"{row:{width}}" + "".join(f"{t:>{w}}" for t, w in zip(texts, wide, strict=True)))
    lines += ["", *text] if (text := _unanswered(results)) else []
    if metrics.get("trust"):
        lines += ["", "Can it be trusted?"]
        lines += [f"  {c['verdict']:8}{c['name']}: {c['says']}" for c in metrics["trust"]]
    return "\n".join(lines).strip("\n")
