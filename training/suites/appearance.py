"""How attacks look: the same images under each, side by side, with figures of visibility."""

from __future__ import annotations

from moireaug.attacks.patch import Patch
from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.conditions import Condition, controls
from moireaug.evaluation.tables import SuiteConfig, Table, eps_row, undefended_row


def appearance(config: SuiteConfig) -> Table:
    """Paper, appendix B: the Moiré Attack beside BIM and an adversarial patch."""
    eps, steps = config.middle, config.steps
    columns: dict[str, Condition] = controls(eps) | {
        "ma": MoireAttacker(eps=eps, steps=steps, until_fooled=False),
        "bim": PixelAttacker(attack="bim", eps=eps, steps=steps, until_fooled=False),
        "patch": PixelAttacker(attack="patch", eps=Patch.eps, steps=steps, until_fooled=False),
    }
    cells = undefended_row(eps_row(eps), columns)
    pictures = [cell.place for cell in cells]
    note_values = {"area": Patch.area}
    return Table("appearance", tuple(cells), pictures=tuple(pictures), note_values=note_values)
