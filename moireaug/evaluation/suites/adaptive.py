"""Attackers who know the defence, search harder, move the camera, or do not know the pose; and the
worst of them."""

from __future__ import annotations

from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker, PoseUnknown, movable_parts
from moireaug.evaluation.autoattack import Apgd, SquareAttacker, TargetedApgd
from moireaug.evaluation.conditions import Condition
from moireaug.evaluation.judges import UNDEFENDED
from moireaug.evaluation.suites.paper import controls
from moireaug.evaluation.tables import (
    Cell,
    SuiteConfig,
    Table,
    cross,
    eps_row,
    paper_defences,
    row_of,
    worst_of,
)

# of the paper's defences: a codec, a filter, a randomised one
ATTACKED_DEFENCES = ("jpeg_60", "median_3", "pixel_deflection")
WORST_EPS = (4 / 255, 8 / 255)
SQUARE_QUERIES_PER_STEP = 20  # for each gradient step of the others


def adaptive(config: SuiteConfig) -> Table:
    """Lay out attackers who know the defence, search harder, or do not know the pose: of three of
    the paper's defences, and of all that the user has added."""
    eps, steps = config.middle, config.steps
    added = [name for name in config.defences if name not in paper_defences()]
    defences = (*ATTACKED_DEFENCES, *added)
    plain = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
    columns: dict[str, Condition] = controls(eps) | {
        "ma": plain,
        "adaptive": Apgd(eps=eps, steps=steps),
        "pose_unknown": PoseUnknown(eps=eps, steps=steps),
    }
    parts, reason = movable_parts(config.scene)
    if parts:
        columns["turning"] = _turning(eps, steps, parts)
    cells = cross({"undefended": UNDEFENDED}, columns)
    for name in defences:
        judge = config.behind(name)
        cells += cross({name: judge}, controls(eps) | {"ma": plain})
        cells.append(Cell(name, "adaptive", (Apgd(eps=eps, steps=steps, knows=judge),), judge))
    # of the attackers that every row has, or rows could not be compared
    shared = [cell for cell in cells if cell.column not in ("pose_unknown", "turning")]
    for row in ("undefended", *defences):
        cells.append(worst_of([cell for cell in shared if cell.row == row], row, eps))
    return Table("adaptive", tuple(cells), facts={"why_not_turned": reason})


def standard(config: SuiteConfig) -> Table:
    """Lay out the standard ensemble (AutoAttack; Croce & Hein, 2020), on the raw reading, with
    attackers of the camera's own, and the worst case."""
    all_eps, steps = config.bounds(WORST_EPS), config.steps
    parts, reason = movable_parts(config.scene)
    cells: list[Cell] = []
    for eps in all_eps:
        row = eps_row(eps)
        columns: dict[str, Condition] = controls(eps) | {
            "apgd_ce": MoireAttacker(eps=eps, steps=steps, variant="apgd_ce", rule="apgd"),
            "apgd_t": TargetedApgd(eps=eps, steps=steps),
            "square": SquareAttacker(eps=eps, steps=SQUARE_QUERIES_PER_STEP * steps),
            "pose_unknown": PoseUnknown(eps=eps, steps=steps),
        }
        if parts:
            columns["turning"] = _turning(eps, steps, parts)
        row_cells = row_of(row, columns)
        cells += [*row_cells, worst_of(row_cells, row, eps)]
    facts = {"why_not_turned": reason, "queries": SQUARE_QUERIES_PER_STEP * steps}
    pictures = _picture_places(cells, eps_row(all_eps[0]))
    return Table("standard", tuple(cells), pictures=pictures, facts=facts)


def worst_case(config: SuiteConfig) -> Table:
    """Lay out the attackers who know the shot, their worst case, and PGD on pixels for comparison,
    always at 4 and 8/255, so that models can be compared. The one who does not know
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
        row_cells = row_of(row, columns)
        cells += [*row_cells, worst_of(row_cells, row, eps)]
        cells.append(Cell(row, "pgd", (PixelAttacker(attack="pgd", eps=eps, steps=steps),)))
    return Table("worst_case", tuple(cells), pictures=_picture_places(cells, eps_row(WORST_EPS[0])))


def _turning(eps: float, steps: int, parts: tuple[str, ...]) -> MoireAttacker:
    optimise = ("noise", *parts)
    return MoireAttacker(eps=eps, steps=steps, variant="turns_the_camera", optimise=optimise)


def _picture_places(cells: list[Cell], row: str) -> tuple[tuple[str, str], ...]:
    """Return the places of a row's cells but the worst case, which has no picture of its own."""
    return tuple((cell.row, cell.column) for cell in cells if cell.row == row and not cell.worst)
