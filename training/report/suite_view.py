"""The view of a suite: pivots of its frame of rates."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from moireaug.evaluation.conditions import in_255ths
from moireaug.evaluation.tables import Table
from training.report.numbers import Rate, distinct, moire_text
from training.report.page import name_of, render, title_of
from training.report.suite_tables import note_of, text_of
from training.runs.metrics import SuiteMetrics

CONTROL_COLUMNS = ("clean", "rotated", "rotated_dim", "no_moire", "moire", "random")
Cells = Mapping[tuple[str, str], dict[str, Any]]  # by row and column


def suite_view(
    metrics: SuiteMetrics,
    tables: Sequence[Table],
    lines: pd.DataFrame,
    examples: Mapping[str, list[dict[str, Any]]],
) -> dict[str, Any]:
    """Return the values for the templates of a suite."""
    views = []
    first = None
    needs_note = True
    for table in tables:
        view = _table_view(table, lines[lines["table"] == table.name], metrics)
        view["examples"] = examples.get(table.name, [])
        view["needs_note"] = needs_note
        needs_note = needs_note and not view["examples"]
        if first is None and view["verdict"]:
            first = view
        views.append(view)
    unanswered = _unanswered(lines)
    paragraphs = render(
        "suite_lead.j2",
        first=first,
        tables=views,
        unanswered=unanswered,
        checks=metrics.trust or [],
        trust_n=metrics.trust_n,
    )
    return {
        "name": name_of(metrics),
        "tables": views,
        "first": first,
        "unanswered": unanswered,
        "paragraphs": [text for text in paragraphs.splitlines() if text.strip()],
        "took": sum(metrics.time.values()),
    }


def _table_view(table: Table, lines: pd.DataFrame, metrics: SuiteMetrics) -> dict[str, Any]:
    finite = lines.replace([np.inf, -np.inf], np.nan).astype(object)
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    for cell in finite.where(finite.notna(), None).to_dict("records"):
        cell["control"] = cell["column"] in CONTROL_COLUMNS
        cell["rate"] = Rate(cell["success"], cell["low"], cell["high"])
        cells[cell["row"], cell["column"]] = cell
    noise = []
    for cell in cells.values():
        if cell["psnr"] is not None and cell["judge"] == "model":
            noise.append(cell)
    text = text_of(table.name)
    return {
        "name": table.name,
        "title": text.title,
        "corner": text.corner,
        "columns": table.columns,
        "rows": [_row(table, cells, name) for name in table.rows],
        "note": note_of(table, metrics),
        "empty": getattr(table, "empty", {}),
        "noise": noise,
        "moire": moire_text(cells.values()),
        "has_lpips": lines["lpips"].notna().any(),
        "has_paper": lines["paper"].notna().any(),
        "has_controls": lines["column"].isin(CONTROL_COLUMNS).any(),
        "verdict": verdict(table, cells, metrics.eps),
        "natural": moire_extremes(table, cells),
    }


def _row(table: Table, cells: Cells, name: str) -> dict[str, Any]:
    """Return a row's cells, None where one is missing, with their denominators and their time."""
    row_cells = [cells.get((name, column)) for column in table.columns]
    present = [cell for cell in row_cells if cell is not None]
    return {
        "name": name,
        "cells": row_cells,
        "counted": distinct(cell["counted"] for cell in present),
        "seconds": sum(cell["seconds"] for cell in present) if present else None,
    }


def _success(cells: Cells, row: str, column: str) -> float | None:
    cell = cells.get((row, column))
    return cell["success"] if cell else None


def verdict(table: Table, cells: Cells, eps: float) -> dict[str, Any] | None:
    """Return a table's success rates of the moiré and of the noise, in its row at eps 4, or its
    first, for its strongest attack; None where it lacks the attack, the photo or the random
    noise."""
    row = "eps_4" if "eps_4" in table.rows else table.rows[0]
    attacks = ("worst", "ma", f"ma_{in_255ths(eps)}")  # the strongest first
    attack = next((column for column in attacks if column in table.columns), "")
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
        "bound": cell["bound"],
        "photo": photo,
        "random": random,
        "attack": fooled,
        "counted": cell["counted"],
        # share of the attack's success that its photo has without any noise
        "photo_share": min(1.0, photo / fooled) if fooled > 0 else None,
    }


def moire_extremes(table: Table, cells: Cells) -> dict[str, Any] | None:
    """Return the rows where the moiré alone adds most and least; None if there is an attacker."""
    columns = text_of(table.name).moire
    if columns is None:
        return None
    rows: list[dict[str, Any]] = []
    for row in table.rows:
        photo, plain = (_success(cells, row, columns[kind]) for kind in ("photo", "plain"))
        if photo is not None and plain is not None:
            rows.append({"row": row, "photo": photo, "plain": plain})
    if not rows:
        return None
    rows.sort(key=lambda one: one["photo"] - one["plain"])
    return {"lead": columns["lead"], "most": rows[-1], "least": rows[0]}


def _unanswered(lines: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the number of images without an answer, once for each condition and judge: several
    cells may show one condition, and cells of several conditions are left out."""
    is_single = (lines["condition"] != "worst") & ~lines["condition"].str.endswith(" pooled")
    lines = lines[is_single & (lines["undecided"] > 0)].drop_duplicates(["condition", "judge"])
    unanswered = lines[["undecided", "n"]].to_dict("records")
    for counts, row, column in zip(unanswered, lines["row"], lines["column"], strict=True):
        counts["title"] = f"{title_of(row, 'rows')}, {title_of(column, 'columns')}"
    return unanswered
