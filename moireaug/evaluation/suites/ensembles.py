"""Ensembles of attackers, and the worst of them for each image."""

from __future__ import annotations

from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.autoattack import (
    QUERIES_PER_STEP,
    APGDAttacker,
    APGDTAttacker,
    SquareAttacker,
)
from moireaug.evaluation.conditions import Condition, controls
from moireaug.evaluation.suites.adaptive import attacker_of_the_scene, attackers_of_the_camera
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, eps_row, undefended_row, worst_of

WORST_EPS = (4 / 255, 8 / 255)


def standard(config: SuiteConfig) -> Table:
    """Lay out an ensemble after AutoAttack (Croce & Hein, 2020), on the raw reading: APGD-CE,
    APGD-T and Square, without FAB-T; with attackers of the camera, and the worst case. Beside it
    stands the worst case over scene and noise, with an attacker who also chooses light, lens,
    exposure and development within the scene's ranges: nobody does, but a photo may come so."""
    steps, queries = config.steps, QUERIES_PER_STEP * config.steps
    cells: list[Cell] = []
    for eps in config.bounds(WORST_EPS):
        camera_attackers, reason = attackers_of_the_camera(config, eps)
        columns: dict[str, Condition] = controls(eps) | {
            "apgd_ce": MoireAttacker(eps=eps, steps=steps, variant="apgd_ce", rule="apgd"),
            "apgd_t": APGDTAttacker(eps=eps, steps=steps),
            "square": SquareAttacker(eps=eps, steps=queries),
        }
        row = eps_row(eps)
        row_cells = undefended_row(row, columns | camera_attackers)
        cells += [*row_cells, worst_of(row_cells, row, eps)]
        row_cells += undefended_row(row, {"scene": attacker_of_the_scene(config, eps)})
        cells += [row_cells[-1], worst_of(row_cells, row, eps, "worst_scene")]
    facts = {"why_not_turned": reason, "steps": steps, "queries": queries}
    return Table("standard", tuple(cells), pictures=_first_row_places(cells), facts=facts)


def worst_case(config: SuiteConfig) -> Table:
    """Lay out the attackers who know the shot, their worst case, and PGD on pixels for comparison,
    always at 4 and 8/255, so that models can be compared. The one who does not know the shot is in
    `standard`: on a robust network it took two thirds of the time, and fooled no further image."""
    steps = config.steps
    cells: list[Cell] = []
    for eps in WORST_EPS:
        columns: dict[str, Condition] = controls(eps) | {
            "ma": MoireAttacker(eps=eps, steps=steps),
            "apgd": APGDAttacker(eps=eps, steps=steps),
        }
        row = eps_row(eps)
        row_cells = undefended_row(row, columns)
        cells += [*row_cells, worst_of(row_cells, row, eps)]
        cells.append(Cell(row, "pgd", (PixelAttacker(attack="pgd", eps=eps, steps=steps),)))
    return Table("worst_case", tuple(cells), pictures=_first_row_places(cells))


def _first_row_places(cells: list[Cell]) -> tuple[tuple[str, str], ...]:
    """Return the places of the first row's cells but the worst case, which has no picture."""
    places = [cell.place for cell in cells if not cell.worst]
    return tuple(place for place in places if place[0] == cells[0].row)
