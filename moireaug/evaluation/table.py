"""A table of an evaluation: what its rows and columns are, and which rung before which judge each cell shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from moireaug.evaluation.rungs import Rung
from moireaug.evaluation.sweep import MODEL, Job, Judge


@dataclass(frozen=True)
class Cell:
    """One rung before one judge; or several, their images pooled, or, as `worst`, each image at its worst rung."""

    rungs: tuple[Rung, ...]
    judge: Judge = MODEL
    worst: bool = False


@dataclass(frozen=True)
class Table:
    """A table of success rates.

    Args:
        name: of the suite that it belongs to. title: with the paper's number where it has one.
        corner: what the rows are. rows, columns: titles.
        cells: (row, column) to Cell; a missing one is shown empty.
        note: how to read it.
        visible: columns whose pictures' change is measured and shown.
        pictures: which (row, column) to show.
        published: whether the paper's figures are of these cells: they are of eps 4.
    """

    name: str
    title: str
    corner: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    cells: Mapping[tuple[str, str], Cell]
    note: str = ""
    visible: tuple[str, ...] = ()
    pictures: tuple[tuple[str, str], ...] = ()
    published: bool = True

    def jobs(self) -> list[Job]:
        return [Job(rung, (cell.judge,)) for cell in self.cells.values() for rung in cell.rungs]


def crossed(rows: Sequence[tuple[str, Judge]], columns: Mapping[str, Rung]) -> dict[tuple[str, str], Cell]:
    """Every rung before every judge."""
    return {(title, column): Cell((rung,), judge) for title, judge in rows for column, rung in columns.items()}


def worst_of(cells: Sequence[Cell]) -> Cell:
    """Each image at the worst of these cells, which one judge has seen."""
    return Cell(tuple(rung for cell in cells for rung in cell.rungs), cells[0].judge, worst=True)


def table(name: str, title: str, corner: str, cells: Mapping[tuple[str, str], Cell], **more: Any) -> Table:
    rows, columns = (tuple(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    return Table(name, title, corner, rows, columns, cells, **more)
