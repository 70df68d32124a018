"""What a report says of a suite's table, and shows beside its figures: an entry of tables.toml."""

import re
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

from moireaug.attacks import Patch
from moireaug.evaluation.attackers import PhotoUnknownAttacker
from moireaug.evaluation.autoattack import QUERIES_PER_STEP
from moireaug.evaluation.classifiers import DEFENCE_DRAWS
from moireaug.evaluation.conditions import in_255ths
from moireaug.evaluation.tables import Cell, Table
from training.report.page import environment, read_toml
from training.runs.metrics import SuiteMetrics


class TableText(NamedTuple):
    """What a report says of a table.

    Args:
        corner: head of the first column.
        note: template of the note below it; "" for none.
        pictures: row/column of the cells whose pictures are shown, as a regular expression; {eps}
            is the middle bound, and {first_row} the first row. "" shows none.
        moire: columns with and without moiré of a table without an attacker, `photo` and `plain`,
            and the words, `lead`, that the sentence on their difference begins with.
        one_bound: whether the paper's figures beside it are of one bound alone.
    """

    title: str
    corner: str = ""
    note: str = ""
    pictures: str = ""
    moire: Mapping[str, str] | None = None
    one_bound: bool = False


@cache
def table_texts() -> dict[str, TableText]:
    """Return what reports say of each table, by its name."""
    return {name: TableText(**text) for name, text in read_toml("tables.toml")["tables"].items()}


def text_of(name: str) -> TableText:
    """Return what reports say of a table; of one without an entry its name alone."""
    return table_texts().get(name, TableText(name))


def pictured_cells(table: Table, eps: float) -> list[Cell]:
    """Return the cells whose pictures are shown; a worst case has none.

    Args:
        eps: middle bound of the suite.
    """
    codes, first_row = re.escape(in_255ths(eps)), re.escape(table.rows[0])
    pattern = text_of(table.name).pictures.format(eps=codes, first_row=first_row)
    return [
        cell
        for cell in table.cells
        if not cell.worst and re.fullmatch(pattern, f"{cell.row}/{cell.column}")
    ]


def note_of(table: Table, metrics: SuiteMetrics) -> str:
    """Return the note below a table, as plain text."""
    values: dict[str, Any] = {
        "area": Patch.area,
        "codes": in_255ths(metrics.eps),
        "draws": DEFENCE_DRAWS,
        "has_square": "square" in table.columns,
        "own": "" if metrics.scene_name.startswith("custom") else metrics.scene_name,
        "queries": QUERIES_PER_STEP * metrics.steps,
        "shots": PhotoUnknownAttacker.shots,
        "steps": metrics.steps,
        "turns": "turning" in table.columns,
    }
    note = environment().from_string(text_of(table.name).note)
    return note.render(values | read_toml("tables.toml")["texts"])
