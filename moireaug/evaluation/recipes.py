"""What compares recipes: how a model stands the worst of the attackers, and moiré of scenes it was not trained in."""

from __future__ import annotations

from moireaug.evaluation import rungs
from moireaug.evaluation.adaptive import blind, strong
from moireaug.evaluation.given import Given, controls
from moireaug.evaluation.rungs import MOIRE, NO_MOIRE, Rung, in_scene, moire_attack
from moireaug.evaluation.sweep import MODEL
from moireaug.evaluation.table import Cell, Table, crossed, table, worst_of
from moireaug.scene.presets import PRESETS
from moireaug.scene.scene import Scene

BOUNDS = (4 / 255, 8 / 255)
OWN = "own scene"
CAMERA = ("moiré, δ = 0", "MA", "adaptive MA", "MA, pose unknown")  # what the worst case is the worst of


def worst_case(g: Given) -> Table:
    """Every attacker in front of the camera, and each image at the worst of them; PGD on pixels stands beside."""
    cells: dict[tuple[str, str], Cell] = {}
    for e in BOUNDS:
        row = f"ε = {rungs.label(e)}"
        columns = controls(e) | {"MA": moire_attack(e, g.steps), "adaptive MA": strong(e, g.steps)}
        columns |= {"MA, pose unknown": blind(e, g.steps)}
        cells |= crossed([(row, MODEL)], columns)
        cells[row, "worst case"] = worst_of([cells[row, column] for column in CAMERA])
        cells[row, "PGD on pixels"] = Cell((rungs.rival("pgd", e, g.steps, "PGD"),))
    note = (
        "“Adaptive MA” goes by the margin, with halved steps and two restarts. “Pose unknown”: the noise was found by "
        "expectation over four other draws of the scene a step. “Worst case”: each image counts as fooled where the "
        "photo alone or any of the three MA fools it. PGD perturbs the pixels of the image, which no camera saw; it is "
        "not part of the worst case. Accuracy on all images is in results.csv."
    )
    shown = tuple(key for key in cells if key[0] == "ε = 4" and key[1] != "worst case")
    return table("worst_case", "The worst of the attackers", "bound", cells, note=note, pictures=shown)


def others(scene: Scene) -> dict[str, Scene]:
    """The presets that are another scene and bring the photo back to the image's frame: one that leaves the picture
    turned, as the paper's does, shows a model another task beside the moiré."""
    presets = {name: Scene.preset(name) for name in PRESETS}
    return {name: s for name, s in presets.items() if s.develop.registered and s != scene}


def unseen(g: Given) -> Table:
    """Nobody attacks: natural moiré in the own scene and in every other, beside the same photos without moiré."""
    columns: dict[str, Rung] = {"no moiré": NO_MOIRE, "moiré, δ = 0": MOIRE}
    cells = crossed([(OWN, MODEL)], columns)
    for name, scene in others(g.scene).items():
        there = {column: in_scene(rung, name, lambda _, s=scene: s) for column, rung in columns.items()}
        cells |= crossed([(name, MODEL)], there)
    own = next((name for name in PRESETS if Scene.preset(name) == g.scene), "")
    note = (
        "Nobody attacks. The first row is the scene of this evaluation" + (f", {own}" if own else "") + "; the others "
    )
    note += "are the presets that differ from it and bring the photo back to the image’s frame."
    shown = tuple(key for key in cells if key[1] == "moiré, δ = 0")
    return table("unseen", "Natural moiré in other scenes", "scene", cells, note=note, pictures=shown)
