"""Natural moiré of scenes that a model was not trained in."""

from __future__ import annotations

from moireaug.evaluation.conditions import Condition, Photo, PhotoWithoutMoire
from moireaug.evaluation.tables import SuiteConfig, Table, undefended_row
from moireaug.mixtures import as_scenes, scenes_of
from moireaug.scenes import Scene

OWN_SCENE_ROW = "own_scene"


def other_scenes(config: SuiteConfig) -> dict[str, Scene]:
    """Return the presets that are another scene and bring the photo back to the image's frame, of
    crops where the images are crops: one that leaves the image turned, as the paper's does, changes
    the task as well as adding moiré."""
    others: dict[str, Scene] = {}
    for name in Scene.presets():
        if Scene.preset(name).develop.registered:
            (scene,) = scenes_of(as_scenes(name, config.shrink))
            others[name] = scene
    return {name: scene for name, scene in others.items() if scene not in scenes_of(config.scene)}


def unseen(config: SuiteConfig) -> Table:
    """Lay out natural moiré in the own scene and in every other, next to the same photos without
    moiré."""
    columns: dict[str, Condition] = {"no_moire": PhotoWithoutMoire(), "moire": Photo()}
    cells = undefended_row(OWN_SCENE_ROW, columns)
    for name, scene in other_scenes(config).items():
        cells += undefended_row(name, {key: c.at(name, scene) for key, c in columns.items()})
    return Table("unseen", tuple(cells))
