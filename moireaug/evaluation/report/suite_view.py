"""What the report of a suite shows: pivots of its frame of rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from moireaug.evaluation.frame import MEASURES
from moireaug.evaluation.report.numbers import finite
from moireaug.evaluation.report.page import render, title_of
from moireaug.evaluation.report.run_view import Metrics, Rate, name_of
from moireaug.evaluation.tables import Table

ATTACKS = ("worst", "ma")  # columns of a table, the strongest first
# of the tables without an attacker: the column with moiré, and the one without
UNATTACKED = {"threat": ("all", "all_no_moire"), "unseen": ("moire", "no_moire")}
CONTROLS = ("clean", "rotated", "rotated_dim", "no_moire", "moire", "random")
Cells = Mapping[tuple[str, str], dict[str, Any]]  # by row and column


def suite_view(
    metrics: Metrics,
    tables: Sequence[Table],
    lines: pd.DataFrame,
    examples: Mapping[str, list[dict[str, Any]]],
) -> dict[str, Any]:
    """Return what the templates of a suite need.

    Args:
        metrics: of the evaluation. tables: its tables. lines: their rates.
        examples: name of a table to its pictures.
    """
    views = []
    first = None
    explained = True
    for table in tables:
        view = _table_view(table, lines[lines["table"] == table.name])
        view["examples"] = examples.get(table.name, [])
        view["explained"] = explained
        explained = explained and not view["examples"]
        if first is None and view["verdict"]:
            first = view
        views.append(view)
    unanswered = _unanswered(lines)
    seconds = metrics.get("time") or {}
    paragraphs = render(
        "suite_lead.j2",
        first=first,
        tables=views,
        unanswered=unanswered,
        checks=metrics.get("trust") or [],
        trust_n=metrics.get("trust_n"),
    )
    return {
        "name": name_of(metrics),
        "tables": views,
        "first": first,
        "unanswered": unanswered,
        "paragraphs": [text for text in paragraphs.splitlines() if text.strip()],
        "took": sum(seconds.values()),
    }


def _table_view(table: Table, lines: pd.DataFrame) -> dict[str, Any]:
    cells = {}
    for line in lines.to_dict("records"):
        cells[line["row"], line["column"]] = _cell(line)
    noise = []
    has_lpips = has_paper = has_controls = False
    for cell in cells.values():
        has_lpips = has_lpips or cell["lpips"] is not None
        has_paper = has_paper or cell["paper"] is not None
        has_controls = has_controls or cell["control"]
        if cell["psnr"] is not None and cell["judge"] == "model":
            noise.append(cell)
    return {
        "name": table.name,
        "columns": table.columns,
        "rows": [_row(table, cells, name) for name in table.rows],
        "facts": table.facts,
        "empty": table.empty,
        "noise": noise,
        "has_lpips": has_lpips,
        "has_paper": has_paper,
        "has_controls": has_controls,
        "verdict": verdict(table, cells),
        "natural": natural(table, cells),
    }


def _row(table: Table, cells: Cells, name: str) -> dict[str, Any]:
    """Return a row's cells, None where one is missing, with their denominators and their time."""
    own = []
    counts: list[str] = []
    seconds = None
    for column in table.columns:
        cell = cells.get((name, column))
        own.append(cell)
        if cell is None:
            continue
        seconds = (seconds or 0.0) + cell["seconds"]
        if str(cell["counted"]) not in counts:
            counts.append(str(cell["counted"]))
    return {"name": name, "cells": own, "counted": " / ".join(counts), "seconds": seconds}


def _cell(line: dict[str, Any]) -> dict[str, Any]:
    found = {}
    for name in ("row", "column", "counted", "n", "judge", "seconds", "eps"):
        found[name] = line[name]
    for name in ("success", "low", "high", "paper", *MEASURES):
        found[name] = finite(line[name])
    found["control"] = line["column"] in CONTROLS
    found["side"] = Rate(found["success"], found["low"], found["high"])
    return found


def _success(cells: Cells, row: str, column: str) -> float | None:
    cell = cells.get((row, column))
    return cell["success"] if cell else None


def verdict(table: Table, cells: Cells) -> dict[str, Any] | None:
    """Return what a table says of the moiré and of the noise, on its row at eps 4, or its first, by
    the attack that it names, or the strongest that it has; None where it lacks one, the photo or
    the random noise."""
    row = "eps_4" if "eps_4" in table.rows else table.rows[0]
    named = table.facts.get("attack")
    there = [column for column in (named, *ATTACKS) if column in table.columns]
    if not there:
        return None
    attack = there[0]
    photo = _success(cells, row, "moire")
    random = _success(cells, row, "random")
    fooled = _success(cells, row, attack)
    if photo is None or random is None or fooled is None:
        return None
    cell = cells[row, attack]
    return {
        "row": row,
        "column": attack,
        "eps": cell["eps"],
        "photo": photo,
        "random": random,
        "attack": fooled,
        "counted": cell["counted"],
        # share of the attack's success that its photo has without any noise
        "photo_share": min(1.0, photo / fooled) if fooled > 0 else None,
        "others": _others(table, cells, row, attack),
    }


def _others(table: Table, cells: Cells, row: str, attack: str) -> dict[str, Any] | None:
    """Return what the photo does in the other rows, and where the noise adds most."""
    photos, added = [], {}
    for other in table.rows:
        alone, both = _success(cells, other, "moire"), _success(cells, other, attack)
        if other != row and alone is not None and both is not None:
            photos.append(alone)
            added[other] = max(0.0, both - alone)
    if not photos:
        return None
    most = max(added, key=lambda name: added[name])
    return {"least": min(photos), "most": max(photos), "added": added[most], "row": most}


def natural(table: Table, cells: Cells) -> dict[str, Any] | None:
    """Return where the moiré alone adds most and least; None for a table with an attacker."""
    if table.name not in UNATTACKED:
        return None
    with_moire, without = UNATTACKED[table.name]
    found: list[dict[str, Any]] = []
    for row in table.rows:
        photo, plain = _success(cells, row, with_moire), _success(cells, row, without)
        if photo is not None and plain is not None:
            found.append({"row": row, "photo": photo, "plain": plain})
    if not found:
        return None
    found.sort(key=lambda one: one["photo"] - one["plain"])
    return {"table": table.name, "most": found[-1], "least": found[0]}


def _unanswered(lines: pd.DataFrame) -> list[dict[str, Any]]:
    """Return how many images had no answer, for each condition that a judge saw; several cells may
    show one. A cell of several conditions counts only what is counted already."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in lines.to_dict("records"):
        single = line["condition"] != "worst" and not line["condition"].endswith(" pooled")
        if line["undecided"] and single:
            shown = f"{title_of(line['row'], 'rows')}, {title_of(line['column'], 'columns')}"
            counts = {"undecided": line["undecided"], "n": line["n"], "shown": shown}
            found.setdefault((line["condition"], line["judge"]), counts)
    return list(found.values())
