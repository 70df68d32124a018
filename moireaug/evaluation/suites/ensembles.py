"""Ensembles of attackers, who know the model, its defence or the pose, or move the camera; and the
worst of them for each image."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any

from moireaug.attacks.camera import searched_fields
from moireaug.defenses import DEFENSES, Quilting
from moireaug.evaluation.attackers import MoireAttacker, PhotoUnknownAttacker, PixelAttacker
from moireaug.evaluation.autoattack import (
    QUERIES_PER_STEP,
    APGDAttacker,
    APGDTAttacker,
    SquareAttacker,
)
from moireaug.evaluation.classifiers import UNDEFENDED
from moireaug.evaluation.conditions import Condition, ImageTransform, controls
from moireaug.evaluation.tables import (
    Cell,
    SuiteConfig,
    Table,
    cross,
    eps_row,
    undefended_row,
    worst_of,
)
from moireaug.mixtures import Mixture, scenes_of
from moireaug.scene.parts import PARTS
from moireaug.scenes import Scene

WORST_EPS = (4 / 255, 8 / 255)
# of the paper's defences: a codec, a filter, a randomised one
ATTACKED_DEFENCES = ("jpeg_60", "median_3", "pixel_deflection")
SCENE_DRAWS = 10


def standard(config: SuiteConfig) -> Table:
    """Lay out an ensemble after AutoAttack (Croce & Hein, 2020), on the raw reading: APGD-CE,
    APGD-T and Square, without FAB-T; with attackers of the camera, and the worst case. Beside it
    stands the worst case over scene and noise, with an attacker who also chooses light, lens,
    exposure and development within the scene's ranges: nobody does, but a photo may come so."""
    steps = config.steps
    cells: list[Cell] = []
    for eps in config.bounds(WORST_EPS):
        columns: dict[str, Condition] = controls(eps) | {
            "apgd_ce": MoireAttacker(eps=eps, steps=steps, variant="apgd_ce", rule="apgd"),
            "apgd_t": APGDTAttacker(eps=eps, steps=steps),
            "square": SquareAttacker(eps=eps, steps=QUERIES_PER_STEP * steps),
        }
        row = eps_row(eps)
        row_cells = undefended_row(row, columns | attackers_of_the_camera(config, eps))
        scene_cell = Cell(row, "scene", (attacker_of_the_scene(config, eps),))
        cells += [*row_cells, worst_of(row_cells, row, eps)]
        cells += [scene_cell, worst_of([*row_cells, scene_cell], row, eps, "worst_scene")]
    return Table("standard", tuple(cells))


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
    return Table("worst_case", tuple(cells))


def adaptive(config: SuiteConfig) -> Table:
    """Lay out attackers who know the defence: of three of the paper's defences, and of all that the
    user has added. The user's, also under a name of the paper's, are searched without gradients,
    too, which a defence may hide. Only the undefended row has attackers of the camera, and so they
    are in no worst case, or rows could not be compared."""
    eps, steps = config.middle, config.steps
    cells: list[Cell] = []
    worst_cells: list[Cell] = []  # the last column
    added = [name for name in config.defences if name not in DEFENSES]
    for row in ("undefended", *ATTACKED_DEFENCES, *added):
        is_defended = row != "undefended"
        classifier = config.behind(row, averages=True) if is_defended else UNDEFENDED
        known: dict[str, Any] = {"eps": eps, "known_classifier": classifier}
        columns: dict[str, Condition] = controls(eps) | {
            "ma": MoireAttacker(eps=eps, steps=steps, until_fooled=False),
            "adaptive": APGDAttacker(steps=steps, **known),
        }
        if is_defended and not _is_paper_defence(row, config.defences[row]):
            columns["square"] = SquareAttacker(steps=QUERIES_PER_STEP * steps, **known)
        row_cells = cross({row: classifier}, columns)
        cells += row_cells
        if not is_defended:
            cells += undefended_row(row, attackers_of_the_camera(config, eps))
        worst_cells.append(worst_of(row_cells, row, eps))
    return Table("adaptive", (*cells, *worst_cells))


def _is_paper_defence(name: str, defence: ImageTransform) -> bool:
    """Return whether a defence is the paper's of that name, and no user's in its place."""
    if name == "quilting":  # the paper's, once it has its patches
        return isinstance(defence, Quilting)
    return name in DEFENSES and defence == DEFENSES[name]()


def attackers_of_the_camera(config: SuiteConfig, eps: float) -> dict[str, Condition]:
    """Return the attackers by column who do not know the photo, and, where every scene varies them,
    who vary pose and panel."""
    steps = config.steps
    attackers: dict[str, Condition] = {"photo_unknown": PhotoUnknownAttacker(eps=eps, steps=steps)}
    if parts := movable_parts(config.scene, ("view", "panel")):
        attackers["turning"] = MoireAttacker(
            eps=eps, steps=steps, variant="turns_the_camera", optimise=("noise", *parts)
        )
    return attackers


def attacker_of_the_scene(config: SuiteConfig, eps: float) -> MoireAttacker:
    """Return the attacker who moves all that varies in the scene, with the noise: screen, pose,
    lens, exposure and development, from the worst of `SCENE_DRAWS` shots."""
    return MoireAttacker(
        eps=eps,
        steps=config.steps,
        variant="moves_the_scene",
        optimise=("noise", *movable_parts(config.scene, tuple(PARTS))),
        draws=SCENE_DRAWS,
    )


def movable_parts(scene: Scene | Mixture, candidates: Sequence[str]) -> tuple[str, ...]:
    """Return those parts that an attacker can search in every scene of a mixture."""
    parts = []
    for part in candidates:
        with contextlib.suppress(ValueError):
            for one in scenes_of(scene):
                searched_fields(one, (part,))
            parts.append(part)
    return tuple(parts)
