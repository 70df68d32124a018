"""The ladder: shares of the camera, the moiré and the noise in an attack's success.

Every row shows a model the same images through the same shots, and adds one thing to the row
before. The paper's tables lack the rows between clean and attacked: on ImageNet the moiré alone
often fools as many images as the attack.
"""

from __future__ import annotations

from moireaug.evaluation.attackers import MoireAttacker, PhotoUnknownAttacker, PixelAttacker
from moireaug.evaluation.autoattack import APGDAttacker
from moireaug.evaluation.conditions import (
    BrightPhotoWithoutMoire,
    Clean,
    Condition,
    Dimmed,
    Photo,
    PhotoWithoutMoire,
    RandomNoise,
    in_255ths,
)
from moireaug.evaluation.tables import DEFAULT_EPS, Cell, SuiteConfig, Table, worst_of

ANSWER_COLUMN = "answer"  # the one column
FOOLED_COLUMN = "fooled"  # the one column of the full ladder


def ladder_conditions(config: SuiteConfig) -> list[Condition]:
    """Return the conditions of the rows that have one: the controls first, then the Moiré Attack at
    each eps, targeted at the middle one, then PGD."""
    eps, middle, steps = config.bounds(DEFAULT_EPS), config.middle, config.steps
    return [
        *(Clean(), Dimmed(), PhotoWithoutMoire(), Photo(), RandomNoise(eps=eps[-1])),
        *(MoireAttacker(eps=bound, steps=steps) for bound in eps),
        MoireAttacker(eps=middle, steps=steps, targeted=True),
        PixelAttacker(attack="pgd", eps=middle, steps=steps),
    ]


def main_attack(table: Table) -> Condition:
    """Return the ladder's main attack: the plain Moiré Attack at the middle eps."""
    conditions = [cell.conditions[0] for cell in table.cells]
    plain = [one for one in conditions if one.kind == "ma" and not one.targeted]
    return sorted(plain, key=lambda condition: condition.eps)[len(plain) // 2]


def ladder(config: SuiteConfig) -> Table:
    """Lay out the ladder: a row per condition, and last the worst case at the middle eps, over the
    photo, the Moiré Attack, and APGD with APGD-T, which has no row of its own."""
    cells = []
    for condition in ladder_conditions(config):
        cells.append(Cell(condition.name, ANSWER_COLUMN, (condition,)))
    eps = config.middle
    apgd = Cell("apgd", ANSWER_COLUMN, (APGDAttacker(eps=eps, steps=config.steps),))
    cells.append(worst_of([*cells, apgd], f"worst_{in_255ths(eps)}", eps, ANSWER_COLUMN))
    return Table("ladder", tuple(cells))


def full_ladder(config: SuiteConfig) -> Table:
    """Lay out the ladder with the turned image, as bright as the clean one (dimmed, it is the photo
    without moiré), and with two more attackers at the middle eps: APGD with APGD-T, and noise for
    an unknown photo. On a model that a few steps fool, the latter took twenty times as long as the
    Moiré Attack; one who varies pose and panel took two hundred times as long, and is in
    `standard`."""
    eps, steps = config.middle, config.steps
    conditions = {condition.name: condition for condition in ladder_conditions(config)}
    size = in_255ths(eps)
    conditions[f"photo_unknown_{size}"] = PhotoUnknownAttacker(eps=eps, steps=steps)
    conditions[f"adaptive_{size}"] = APGDAttacker(eps=eps, steps=steps)
    cells = []
    for row, condition in conditions.items():
        if row == "no_moire":
            cells.append(Cell("rotated", FOOLED_COLUMN, (BrightPhotoWithoutMoire(),)))
        cells.append(Cell(row, FOOLED_COLUMN, (condition,)))
    cells.append(worst_of(cells, f"worst_case_{size}", eps, FOOLED_COLUMN))
    return Table("full_ladder", tuple(cells))
