"""Inputs that a model was not trained for: other displays and cameras, photos in another form,
noise on pixels, and corruptions that have nothing to do with screens."""

from functools import partial

from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.conditions import Clean, Condition, Photo
from moireaug.evaluation.suites.scenes import OWN_SCENE_ROW, other_scenes
from moireaug.evaluation.tables import Cell, SuiteConfig, Table
from moireaug.mixtures import Mixture, map_scenes
from moireaug.scene.by_name import with_values
from moireaug.scenes import Scene
from training.suites.corruptions import CORRUPTIONS, Corrupted

UNATTACKED_COLUMN, ATTACKED_COLUMN = "unattacked", "attacked"
JPEG_QUALITY = 60  # of a photo saved as a JPEG file


def shifted_scenes(config: SuiteConfig) -> dict[str, Scene | Mixture]:
    """Return the own scene, every other preset in the image's frame, and the own scene's photos as
    JPEG files and in the camera's frame, unless they already are."""
    own_scene = config.scene
    changed = {
        f"photo_jpeg_{JPEG_QUALITY}": map_scenes(own_scene, _saved_as_jpeg),
        "camera_frame": map_scenes(
            own_scene, partial(with_values, values={"develop.registered": False})
        ),
    }
    scenes = {OWN_SCENE_ROW: own_scene, **other_scenes(config)}
    return scenes | {name: scene for name, scene in changed.items() if scene != own_scene}


def _saved_as_jpeg(scene: Scene) -> Scene:
    if scene.develop.jpeg != 0:
        return scene
    return with_values(scene, {"develop.jpeg": JPEG_QUALITY})


def shifts(config: SuiteConfig) -> Table:
    """Lay out the gains and costs of robustness to moiré elsewhere: each row unattacked, and, where
    there is an attacker, attacked at the middle eps."""
    eps, steps = config.middle, config.steps
    cells: list[Cell] = []
    for name, scene in shifted_scenes(config).items():
        photo: Condition = Photo()
        attacked: Condition = MoireAttacker(eps=eps, steps=steps)
        if name != OWN_SCENE_ROW:  # other suites share the own scene's conditions
            photo, attacked = photo.at(name, scene), attacked.at(name, scene)
        cells.append(Cell(name, UNATTACKED_COLUMN, (photo,)))
        cells.append(Cell(name, ATTACKED_COLUMN, (attacked,)))
    cells.append(Cell("image", UNATTACKED_COLUMN, (Clean(),)))
    pgd = PixelAttacker(attack="pgd", eps=eps, steps=steps)
    cells.append(Cell("image", ATTACKED_COLUMN, (pgd,)))
    for corruption, (_, amounts) in CORRUPTIONS.items():
        for amount in amounts:
            corrupted = Corrupted(corruption=corruption, amount=amount)
            cells.append(Cell(corrupted.name, UNATTACKED_COLUMN, (corrupted,)))
    return Table("shifts", tuple(cells))
