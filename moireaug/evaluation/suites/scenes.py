"""Natural moiré of scenes that a model was not trained in."""

from __future__ import annotations

from moireaug.evaluation.conditions import Condition, Photo, PhotoWithoutMoire
from moireaug.evaluation.tables import SuiteConfig, Table, undefended_row
from moireaug.mixtures import as_scenes, preset_name, scenes_of
from moireaug.scenes import Scene

OWN_SCENE_ROW = "own_scene"


def other_scenes(config: SuiteConfig) -> dict[str, Scene]:
    """Return the presets that are another scene and bring the photo back to the image's frame: one
    that leaves the image turned, as the paper's does, changes the task as well as adding moiré."""
    own = scenes_of(config.scene)
    return {name: scene for name, scene in _registered_presets(config).items() if scene not in own}


def _registered_presets(config: SuiteConfig) -> dict[str, Scene]:
    """Return the presets in the image's frame, of crops where the images are crops."""
    presets: dict[str, Scene] = {}
    for name in Scene.presets():
        preset = Scene.preset(name)
        if preset.develop.registered:
            (presets[name],) = scenes_of(as_scenes(preset, config.shrink))
    return presets


def unseen(config: SuiteConfig) -> Table:
    """Lay out natural moiré in the own scene and in every other, next to the same photos without
    moiré."""
    columns: dict[str, Condition] = {"no_moire": PhotoWithoutMoire(), "moire": Photo()}
    cells = undefended_row(OWN_SCENE_ROW, columns)
    for name, scene in other_scenes(config).items():
        cells += undefended_row(name, {key: c.at(name, scene) for key, c in columns.items()})
    pictures = [cell.place for cell in cells if cell.column == "moire"]
    preset_names = {scene: name for name, scene in _registered_presets(config).items()}
    names = [preset_names.get(one) or preset_name(one) for one in scenes_of(config.scene)]
    own_names = " or ".join(names) if all(names) else ""
    return Table("unseen", tuple(cells), pictures=tuple(pictures), note_values={"own": own_names})
