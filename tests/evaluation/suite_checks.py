"""Checks that the tables of any suite must pass, the library's and the paper's."""

import torch

from moireaug.evaluation import rates
from moireaug.evaluation.attackers import Attacker
from moireaug.evaluation.runner import jobs_of
from tests.evaluation.haze import frame_of

ROUNDED_EPS = tuple((torch.tensor([2.0, 4.0, 8.0]) / 255).tolist())  # by float32


def check_names(tables):
    """Within a suite a name means one thing."""
    names = [job.condition.name for job in jobs_of(tables)]
    assert len(set(names)) == len(names) > 1, tables[0].name


def check_bounds_of_rows(table):
    """An attack stands in the row of its bound."""
    for cell in table.cells:
        attackers = [condition for condition in cell.conditions if not condition.control]
        assert all(f"eps_{attacker.eps * 255:g}" == cell.row for attacker in attackers)


def check_worst_cases(tables, left_out=None):
    """A worst case is of the photo alone, and each attack through the camera within its bound, but
    for the columns that `left_out` names by table; return the number of worst cases."""
    cases = [(table, cell) for table in tables for cell in table.cells if cell.worst]
    for table, worst in cases:
        skipped = (left_out or {}).get(table.name, ())
        if worst.column != "worst_scene":
            skipped += ("scene",)
        names = {condition.name for condition in worst.conditions}
        assert "moire" in names and len(names) == len(worst.conditions) > 2
        eps = max(condition.eps for condition in worst.conditions)
        beside = [cell for cell in table.cells if cell.row == worst.row or len(table.columns) == 1]
        for cell in (cell for cell in beside if len(cell.conditions) == 1):
            (condition,) = cell.conditions
            attacks = isinstance(condition, Attacker) and cell.column not in skipped
            counts = attacks and condition.on_screen and condition.eps <= eps
            assert (condition.name in names) == (counts or condition.name == "moire"), worst.row
    return len(cases)


def deaf(images):
    """Says one class, whatever it is shown."""
    return torch.tensor([0.0, 1.0, 0.0]).repeat(len(images), 1) + 0 * images.mean()


def check_that_nothing_fools_the_deaf(known, table):
    """Negative control: a table that finds success here counts wrongly."""
    batches = [(known[1][0][0][:4], torch.tensor([1, 1, 1, 2]))]
    for line in rates(frame_of((deaf, batches), table)).to_dict("records"):
        found = (line["success"], line["accuracy"], line["counted"])
        assert found == (0.0, 0.75, 3), (line["row"], line["column"])
