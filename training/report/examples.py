"""Pictures for a report: the first batch under several conditions, with the models' answers."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from moireaug.attacks import REJECTED, UNDECIDED
from moireaug.evaluation.classifiers import UNDEFENDED
from moireaug.evaluation.conditions import Condition, Photo
from moireaug.evaluation.runner import CLEAN, Runner
from moireaug.evaluation.tables import Cell, Table
from training.report.page import title_of
from training.report.suite_tables import pictured_cells

CHANGE_GAIN = 4  # factor by which an attack's change of the photo is enlarged
PHOTO = Photo()
NO_CLASS = {UNDECIDED: "no answer", REJECTED: "rejected"}
Example = dict[str, Any]


def run_examples(
    runners: Mapping[str, Runner], attack: Condition, classes: Mapping[int, str]
) -> list[Example]:
    """Return each recorded image clean, photographed, and attacked on every model, with each
    attack's change enlarged; a photo that a model has wrong already is not attacked.

    Args:
        runners: name of a model to its runner; all have run on the same images and shots.
    """
    first = next(iter(runners.values()))
    pictures = first.records.picture(first.picture_name(CLEAN))
    if pictures is None:
        return []
    examples = []
    for row in range(len(pictures)):
        label = first.record(CLEAN, UNDEFENDED, 0)["labels"][row]
        cells = []
        for condition, title in ((CLEAN, "clean image"), (PHOTO, "photographed")):
            cells += _cell(runners, first, condition, row, title, classes)
        for name, runner in runners.items():
            title = f"attack on {name}, {attack.eps * 255:g}/255"
            if change := _change(runner, attack, row):
                cells += _cell({name: runner}, runner, attack, row, title, classes) + change
        examples.append({"label": classes.get(label, str(label)), "cells": cells})
    return examples


def table_examples(
    table: Table, runner: Runner, classes: Mapping[int, str], name: str, eps: float
) -> list[Example]:
    """Return a table's pictures of one image, the first that the model gets right, with its answer
    to each; arguments as of `pictured_cells`."""
    clean = runner.record(CLEAN, UNDEFENDED, 0)
    pictures = runner.records.picture(runner.picture_name(CLEAN))
    pictured = pictured_cells(table, eps)
    if pictures is None or not pictured:
        return []
    row = 0
    for i in range(len(pictures) - 1, -1, -1):
        if clean["predicted"][i] == clean["labels"][i]:
            row = i
    cells = []
    for cell in pictured:
        title = _title(pictured, cell)
        cells += _cell({name: runner}, runner, cell.conditions[0], row, title, classes)
    label = clean["labels"][row]
    return [{"label": classes.get(label, str(label)), "cells": cells}]


def _cell(
    runners: Mapping[str, Runner],
    source: Runner,
    condition: Condition,
    row: int,
    title: str,
    classes: Mapping[int, str],
) -> list[dict[str, Any]]:
    """Return a picture with the models' answers; none where no picture was recorded."""
    pictures = source.records.picture(source.picture_name(condition))
    if pictures is None:
        return []
    predictions = []
    for name, runner in runners.items():
        record = runner.record(condition, UNDEFENDED, 0)
        answer = record["predicted"][row]
        answer_name = NO_CLASS.get(answer) or classes.get(answer, str(answer))
        predictions.append((name, answer_name, answer == record["labels"][row]))
    return [{"title": title, "image": pictures[row], "predictions": predictions}]


def _change(runner: Runner, attack: Condition, row: int) -> list[dict[str, Any]]:
    """Return the change of the photo by the noise, enlarged; none where there is none."""
    attacked = runner.records.picture(runner.picture_name(attack))
    photo = runner.records.picture(runner.picture_name(PHOTO))
    if attacked is None or photo is None:
        return []
    change = attacked[row].astype(float) - photo[row]
    if not change.any():
        return []
    image = np.clip(127.5 + CHANGE_GAIN * change, 0, 255).round().astype(np.uint8)
    return [{"title": f"its change, × {CHANGE_GAIN}", "image": image, "predictions": []}]


def _title(cells: Sequence[Cell], cell: Cell) -> str:
    """Return a picture's title: its row, its column or both, as its neighbours need."""
    row, column = title_of(cell.row, "rows"), title_of(cell.column, "columns")
    if len({other.row for other in cells}) == 1:
        return column
    if len({other.column for other in cells}) == 1:
        return row
    return f"{row}, {column}"
