"""Attackers who know the defence, move the camera, or do not know the pose; and the worst of
them."""

from __future__ import annotations

from collections.abc import Sequence

from moireaug.attacks.pose import searched_fields
from moireaug.defenses import DEFENSES, Quilting
from moireaug.evaluation.attackers import MoireAttacker, PoseUnknownAttacker
from moireaug.evaluation.autoattack import QUERIES_PER_STEP, APGDAttacker, SquareAttacker
from moireaug.evaluation.classifiers import DEFENCE_DRAWS, UNDEFENDED
from moireaug.evaluation.conditions import Condition, ImageTransform, controls
from moireaug.evaluation.tables import (
    Cell,
    SuiteConfig,
    Table,
    cross,
    undefended_row,
    worst_of,
)
from moireaug.mixtures import Mixture, scenes_of
from moireaug.scene.parts import PARTS
from moireaug.scenes import Scene

# of the paper's defences: a codec, a filter, a randomised one
ATTACKED_DEFENCES = ("jpeg_60", "median_3", "pixel_deflection")
SCENE_DRAWS = 10


def adaptive(config: SuiteConfig) -> Table:
    """Lay out attackers who know the defence: of three of the paper's defences, and of all that the
    user has added. The user's, also under a name of the paper's, are searched without gradients,
    too, which a defence may hide. Only the undefended row has attackers of the camera, and so they
    are in no worst case, or rows could not be compared."""
    eps, steps = config.middle, config.steps
    camera_attackers, reason = attackers_of_the_camera(config, eps)
    added = [name for name in config.defences if name not in DEFENSES]
    rows = (*ATTACKED_DEFENCES, *added)
    user_defences = [
        name for name in rows if not _is_paper_defence(name, config.defences.get(name))
    ]
    classifiers = {"undefended": UNDEFENDED}
    for name in rows:
        classifiers[name] = config.behind(name, averages=True)
    queries = QUERIES_PER_STEP * steps
    cells: list[Cell] = []
    worst_cells: list[Cell] = []  # the last column
    for row, classifier in classifiers.items():
        columns: dict[str, Condition] = controls(eps) | {
            "ma": MoireAttacker(eps=eps, steps=steps, until_fooled=False),
            "adaptive": APGDAttacker(eps=eps, steps=steps, known_classifier=classifier),
        }
        if row in user_defences:
            columns["square"] = SquareAttacker(eps=eps, steps=queries, known_classifier=classifier)
        row_cells = cross({row: classifier}, columns)
        cells += row_cells
        if classifier is UNDEFENDED:
            cells += undefended_row(row, camera_attackers)
        worst_cells.append(worst_of(row_cells, row, eps))
    note_values = {
        "why_not_turned": reason,
        "draws": DEFENCE_DRAWS,
        "shots": PoseUnknownAttacker.shots,
    }
    if user_defences:
        note_values["queries"] = queries
    return Table("adaptive", (*cells, *worst_cells), note_values=note_values)


def _is_paper_defence(name: str, defence: ImageTransform | None) -> bool:
    """Return whether a defence is the paper's of that name, and no user's in its place."""
    if name == "quilting":  # the paper's, once it has its patches
        return isinstance(defence, Quilting)
    return name in DEFENSES and defence == DEFENSES[name]()


def attackers_of_the_camera(config: SuiteConfig, eps: float) -> tuple[dict[str, Condition], str]:
    """Return the attackers by column who do not know the pose, and who turn the camera; and, where
    no scene lets it be turned, the reason."""
    steps = config.steps
    attackers: dict[str, Condition] = {"pose_unknown": PoseUnknownAttacker(eps=eps, steps=steps)}
    parts, reason = movable_parts(config.scene, ("view", "panel"))
    if parts:
        attackers["turning"] = MoireAttacker(
            eps=eps, steps=steps, variant="turns_the_camera", optimise=("noise", *parts)
        )
    return attackers, reason


def attacker_of_the_scene(config: SuiteConfig, eps: float) -> MoireAttacker:
    """Return the attacker who moves all that varies in the scene, with the noise: screen, pose,
    lens, exposure and development, from the worst of `SCENE_DRAWS` shots."""
    parts, _ = movable_parts(config.scene, tuple(PARTS))
    return MoireAttacker(
        eps=eps,
        steps=config.steps,
        variant="moves_the_scene",
        optimise=("noise", *parts),
        draws=SCENE_DRAWS,
    )


def movable_parts(scene: Scene | Mixture, candidates: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """Return those parts that an attacker can search in every scene of a mixture, and, where there
    is none, the reason."""
    parts, reason = [], ""
    for part in candidates:
        try:
            for one in scenes_of(scene):
                searched_fields(one, (part,))
            parts.append(part)
        except ValueError as error:
            reason = reason or str(error)
    return tuple(parts), "" if parts else reason
