"""The ladder: how much of an attack's success is the camera, how much the moiré, how much the
noise.

Every rung shows a model the same images through the same shots; each adds one thing to the rung
before. The paper's tables lack the rungs between clean and attacked: on ImageNet the moiré alone
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
from moireaug.evaluation.tables import EPS, Cell, SuiteConfig, Table

ANSWER = "answer"  # the one column


def rungs(config: SuiteConfig) -> list[Condition]:
    """Return the rungs of one condition: the controls first, then the Moiré Attack at each eps,
    targeted at the middle one, then PGD."""
    eps = config.bounds(EPS)
    steps = config.steps
    found: list[Condition] = [Clean(), Dimmed(), PhotoWithoutMoire(), Photo()]
    found.append(RandomNoise(eps=eps[-1]))
    for bound in eps:
        found.append(MoireAttacker(eps=bound, steps=steps))
    found.append(MoireAttacker(eps=config.middle, steps=steps, targeted=True))
    found.append(PixelAttacker(attack="pgd", eps=config.middle, steps=steps))
    return found


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
    """Lay out the ladder: a row per rung, and last each image at the worst of its photo, the Moiré
    Attack, APGD and APGD-T at the middle eps."""
    cells = []
    for condition in rungs(config):
        cells.append(Cell(condition.name, ANSWER, (condition,)))
    eps, steps = config.middle, config.steps
    plain = MoireAttacker(eps=eps, steps=steps)
    tried = (Photo(), plain, Apgd(eps=eps, steps=steps))
    cells.append(Cell(f"worst_{codes(eps)}", ANSWER, tried, worst=True))
    shown = ("clean", "moire", plain.name)
    return Table("ladder", tuple(cells), pictures=tuple((row, ANSWER) for row in shown))
