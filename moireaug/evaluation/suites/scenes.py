"""Natural moiré of displays and cameras, and of scenes that a model was not trained in."""

from __future__ import annotations

from moireaug.evaluation.conditions import Condition, Photo, PhotoWithoutMoire
from moireaug.evaluation.suites.threat_scenes import (
    ANGLES,
    DISPLAY_CAMERA_PAIRS,
    DISPLAYS,
    threat_scene,
)
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, undefended_row
from moireaug.mixtures import as_scenes, scenes_of
from moireaug.scene.presets import PRESETS
from moireaug.scenes import Scene, as_scene, preset_name

OWN_SCENE_ROW = "own_scene"


def threat(config: SuiteConfig) -> Table:
    """Paper, section 3.1 and figure 3: displays x cameras x angles."""
    cells: list[Cell] = []
    for display, camera in DISPLAY_CAMERA_PAIRS:
        row = f"{display}, {camera}"
        photos, plain = [], []
        for angle in ANGLES:
            place = f"{row}, {angle}"
            scene = as_scenes(threat_scene(display, camera, angle), config.shrink)
            photos.append(Photo().at(place, scene))
            plain.append(PhotoWithoutMoire().at(place, scene))
            cells.append(Cell(row, f"angle_{angle}", (photos[-1],)))
        cells.append(Cell(row, "all", tuple(photos)))
        cells.append(Cell(row, "all_no_moire", tuple(plain)))
    pictures = []
    for display in DISPLAYS:
        pictures.append((f"{display}, {DISPLAY_CAMERA_PAIRS[0][1]}", "angle_90"))
    for angle in ANGLES:
        pictures.append((", ".join(DISPLAY_CAMERA_PAIRS[-1]), f"angle_{angle}"))
    return Table("threat", tuple(cells), pictures=tuple(pictures))


def other_scenes(config: SuiteConfig) -> dict[str, Scene]:
    """Return the presets that are another scene and bring the photo back to the image's frame: one
    that leaves the image turned, as the paper's does, changes the task as well as adding moiré."""
    own = scenes_of(config.scene)
    return {name: scene for name, scene in _registered_presets(config).items() if scene not in own}


def _registered_presets(config: SuiteConfig) -> dict[str, Scene]:
    """Return the presets in the image's frame, of crops where the images are crops."""
    presets = {}
    for name in PRESETS:
        preset = as_scene(name)
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
    known = {scene: name for name, scene in _registered_presets(config).items()}
    names = [known.get(one) or preset_name(one) for one in scenes_of(config.scene)]
    own_names = " or ".join(names) if all(names) else ""
    return Table("unseen", tuple(cells), pictures=tuple(pictures), facts={"own": own_names})
