"""The ladder: shares of the camera, the moiré and the noise in an attack's success.

Every row shows a model the same images through the same shots, and adds one thing to the row
before. The paper's tables lack the rows between clean and attacked: on ImageNet the moiré alone
often fools as many images as the attack.
"""

from __future__ import annotations

from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.autoattack import Apgd
from moireaug.evaluation.conditions import (
    Clean,
    Condition,
    Dimmed,
    Photo,
    PhotoWithoutMoire,
    RandomNoise,
    codes,
)
from moireaug.evaluation.tables import DEFAULT_EPS, Cell, SuiteConfig, Table

ANSWER_COLUMN = "answer"  # the one column


def ladder_conditions(config: SuiteConfig) -> list[Condition]:
    """Return the conditions of the rows that have one: the controls first, then the Moiré Attack at
    each eps, targeted at the middle one, then PGD."""
    eps = config.bounds(DEFAULT_EPS)
    steps = config.steps
    conditions: list[Condition] = [Clean(), Dimmed(), PhotoWithoutMoire(), Photo()]
    conditions.append(RandomNoise(eps=eps[-1]))
    for bound in eps:
        conditions.append(MoireAttacker(eps=bound, steps=steps))
    conditions.append(MoireAttacker(eps=config.middle, steps=steps, targeted=True))
    conditions.append(PixelAttacker(attack="pgd", eps=config.middle, steps=steps))
    return conditions


def main_attack(table: Table) -> Condition:
    """Return the ladder's main attack: the plain Moiré Attack at the middle eps."""
    plain = []
    for cell in table.cells:
        condition = cell.conditions[0]
        if condition.kind == "ma" and not condition.targeted:
            plain.append(condition)
    plain.sort(key=lambda condition: condition.eps)
    return plain[len(plain) // 2]


def ladder(config: SuiteConfig) -> Table:
    """Lay out the ladder: a row per condition, and last each image at the worst of its photo, the
    Moiré Attack, APGD and APGD-T at the middle eps."""
    cells = []
    for condition in ladder_conditions(config):
        cells.append(Cell(condition.name, ANSWER_COLUMN, (condition,)))
    eps, steps = config.middle, config.steps
    plain = MoireAttacker(eps=eps, steps=steps)
    worst_conditions = (Photo(), plain, Apgd(eps=eps, steps=steps))
    cells.append(Cell(f"worst_{codes(eps)}", ANSWER_COLUMN, worst_conditions, worst=True))
    picture_rows = ("clean", "moire", plain.name)
    pictures = tuple((row, ANSWER_COLUMN) for row in picture_rows)
    return Table("ladder", tuple(cells), pictures=pictures)
