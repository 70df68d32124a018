"""Attackers who know the defence, search harder, move the camera, or do not know the pose; and the
worst of them."""

from __future__ import annotations

from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker, PoseUnknown, turnable
from moireaug.evaluation.autoattack import Apgd, SquareAttacker, TargetedApgd
from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.judges import UNDEFENDED
from moireaug.evaluation.suites.paper import controls
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, crossed, eps_row, row_of, worst_of

ADAPTED = ("jpeg_60", "median_3", "pixel_deflection")  # a codec, a filter, a randomised one
WORST_EPS = (4 / 255, 8 / 255)
QUERIES = 20  # of Square, for each gradient step of the others
CAMERA = ("moire", "ma", "apgd")  # the columns of the worst case


def adaptive(config: SuiteConfig) -> Table:
    """Lay out what an attacker gains who knows the defence or searches harder, or loses who does
    not know the pose."""
    eps, steps = config.middle, config.steps
    plain = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
    columns: dict[str, Condition] = controls(eps) | {
        "ma": plain,
        "adaptive": Apgd(eps=eps, steps=steps),
        "pose_unknown": PoseUnknown(eps=eps, steps=steps),
    }
    parts, why = turnable(config.scene)
    if parts:
        columns["turning"] = MoireAttacker(
            eps=eps, steps=steps, variant="turns_the_camera", optimise=("noise", *parts)
        )
    cells = crossed({"undefended": UNDEFENDED}, columns)
    for name in ADAPTED:
        judge = config.behind(name)
        cells += crossed({name: judge}, controls(eps) | {"ma": plain})
        cells.append(Cell(name, "adaptive", (Apgd(eps=eps, steps=steps, knows=judge),), judge))
    for row in ("undefended", *ADAPTED):
        cells.append(worst_of(cells, row))
    return Table("adaptive", tuple(cells), facts={"why_not_turned": why})


def standard(config: SuiteConfig) -> Table:
    """Lay out the standard ensemble (AutoAttack; Croce & Hein, 2020), on the raw reading, with
    attackers of the camera's own; each image at the worst of them and of the photo alone."""
    every, steps = config.bounds(WORST_EPS), config.steps
    parts, why = turnable(config.scene)
    cells: list[Cell] = []
    for eps in every:
        row = eps_row(eps)
        columns: dict[str, Condition] = controls(eps) | {
            "apgd_ce": MoireAttacker(eps=eps, steps=steps, variant="apgd_ce", rule="apgd"),
            "apgd_t": TargetedApgd(eps=eps, steps=steps),
            "square": SquareAttacker(eps=eps, steps=QUERIES * steps),
            "pose_unknown": PoseUnknown(eps=eps, steps=steps),
        }
        if parts:
            columns["turning"] = MoireAttacker(
                eps=eps, steps=steps, variant="turns_the_camera", optimise=("noise", *parts)
            )
        cells += row_of(row, columns)
        tried = [column for column in columns if column not in ("clean", "random")]
        cells.append(worst_of(cells, row, tried))
    facts = {"why_not_turned": why, "queries": QUERIES * steps}
    return Table("standard", tuple(cells), pictures=_shown(cells, eps_row(every[0])), facts=facts)


def worst_case(config: SuiteConfig) -> Table:
    """Lay out the attackers who know the shot, each image at the worst of them, and PGD on pixels
    for comparison, always at 4 and 8/255, so that models can be compared. The one who does not know
    the shot is in `standard`: on a robust network it took two thirds of the time, and fooled no
    further image."""
    cells: list[Cell] = []
    steps = config.steps
    for eps in WORST_EPS:
        row = eps_row(eps)
        columns: dict[str, Condition] = controls(eps) | {
            "ma": MoireAttacker(eps=eps, steps=steps),
            "apgd": Apgd(eps=eps, steps=steps),
        }
        cells += row_of(row, columns)
        cells.append(worst_of(cells, row, CAMERA))
        cells.append(Cell(row, "pgd", (PixelAttacker(attack="pgd", eps=eps, steps=steps),)))
    return Table("worst_case", tuple(cells), pictures=_shown(cells, eps_row(WORST_EPS[0])))


def _shown(cells: list[Cell], row: str) -> tuple[tuple[str, str], ...]:
    """Return the places of a row's cells but the worst case, which has no picture of its own."""
    return tuple((cell.row, cell.column) for cell in cells if cell.row == row and not cell.worst)
