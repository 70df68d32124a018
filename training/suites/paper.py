"""The paper's tables and figures, with the controls that they lack."""

import dataclasses
from collections.abc import Mapping
from functools import partial

from moireaug.attacks.patch import Patch
from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier
from moireaug.evaluation.conditions import (
    BrightPhotoWithoutMoire,
    Condition,
    Photo,
    PhotoWithoutMoire,
    RandomNoise,
    controls,
    in_255ths,
)
from moireaug.evaluation.tables import Cell, SuiteConfig, Table, cross, eps_row, undefended_row
from moireaug.mixtures import map_scenes, scenes_of
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from moireaug.scenes import Scene
from training.suites.config import PaperConfig

PAPER_EPS = (2 / 255, 4 / 255, 6 / 255, 8 / 255)
BUDGET_EPS = (4 / 255, 8 / 255, 16 / 255, 32 / 255)
JPEG_QUALITIES = (20, 40, 60, 80)
DEFENCES_OF_OTHER_TABLES = (*(f"jpeg_{quality}" for quality in JPEG_QUALITIES), "gain")
ROLL_ANGLES = (0, 5, 10, 15, 30, 45)  # degrees


def paper_attacks(config: SuiteConfig) -> dict[str, Condition]:
    """Return the paper's attacks at one eps."""
    eps, steps = config.middle, config.steps
    attackers: dict[str, Condition] = {
        "ma": MoireAttacker(eps=eps, steps=steps, until_fooled=False)
    }
    for name in ("bim", "pgd", "cw", "mifgsm"):
        bound = 0.0 if name == "cw" else eps
        attackers[name] = PixelAttacker(attack=name, eps=bound, steps=steps, until_fooled=False)
    return attackers


def success(config: SuiteConfig) -> Table:
    """Paper, table 1: rotated, rotated and dimmed, targeted and untargeted Moiré Attacks by eps."""
    cells: list[Cell] = []
    for eps in config.bounds(PAPER_EPS):
        columns: dict[str, Condition] = {
            "rotated": BrightPhotoWithoutMoire(),
            "rotated_dim": PhotoWithoutMoire(),
            "moire": Photo(),
            "random": RandomNoise(eps=eps),
            "ma": MoireAttacker(eps=eps, steps=config.steps, until_fooled=False),
            "ma_targeted": MoireAttacker(
                eps=eps, steps=config.steps, targeted=True, until_fooled=False
            ),
        }
        cells += undefended_row(eps_row(eps), columns)
    pictures = [cell.place for cell in cells if cell.row == eps_row(config.middle)]
    return Table("success", tuple(cells), pictures=tuple(pictures))


def mean_normalised(config: SuiteConfig) -> Table:
    """Paper, table 2: the photo's mean brought to the clean image's; and to a fixed mean, as a
    deployed system can."""
    classifiers = {
        "as_it_is": UNDEFENDED,
        "restored": Classifier("restored", restores_mean=True),
        "gain": config.behind("gain"),
    }
    columns = controls(config.middle)
    for eps in config.bounds(PAPER_EPS):
        columns[f"ma_{in_255ths(eps)}"] = MoireAttacker(
            eps=eps, steps=config.steps, until_fooled=False
        )
    note_values = {"codes": in_255ths(config.middle), "attack": f"ma_{in_255ths(config.middle)}"}
    return Table("mean_normalised", tuple(cross(classifiers, columns)), note_values=note_values)


def jpeg(config: SuiteConfig) -> Table:
    """Paper, table 3: the attacks after JPEG."""
    classifiers = {"undefended": UNDEFENDED}
    for quality in JPEG_QUALITIES:
        classifiers[f"jpeg_{quality}"] = config.behind(f"jpeg_{quality}")
    table = _attacks_table("jpeg", config, classifiers, {})
    pictures = tuple(("undefended", column) for column in table.columns)
    return dataclasses.replace(table, pictures=pictures)


def defences(config: PaperConfig) -> Table:
    """Paper, table 4: the attacks after other input transformations."""
    classifiers = {"undefended": UNDEFENDED}
    for name in config.defences:
        if name not in DEFENCES_OF_OTHER_TABLES:
            classifiers[name] = config.behind(name)
    return _attacks_table("defences", config, classifiers, config.without)


def transfer(config: SuiteConfig) -> Table:
    """Paper, table 6: the attacks on the model, classified by other models."""
    classifiers = {"attacked": UNDEFENDED}
    missing = {}
    for name, model in config.targets.items():
        if model is None:
            missing[name] = "weights not at hand"
        else:
            classifiers[name] = Classifier(name, model=model)
    return _attacks_table("transfer", config, classifiers, missing)


def _attacks_table(
    name: str, config: SuiteConfig, classifiers: Mapping[str, Classifier], empty: Mapping[str, str]
) -> Table:
    """Lay out the paper's attacks, and their controls, before each classifier."""
    cells = cross(classifiers, controls(config.middle) | paper_attacks(config))
    return Table(name, tuple(cells), empty=empty)


def budget(config: SuiteConfig) -> Table:
    """Paper, section 4.5 and figure 4: success and visibility by eps."""
    cells: list[Cell] = []
    for eps in config.bounds(BUDGET_EPS):
        columns: dict[str, Condition] = {
            "moire": Photo(),
            "random": RandomNoise(eps=eps),
            "ma": MoireAttacker(eps=eps, steps=config.steps, until_fooled=False),
            "bim": PixelAttacker(attack="bim", eps=eps, steps=config.steps, until_fooled=False),
        }
        cells += undefended_row(eps_row(eps), columns)
    pictures = [cell.place for cell in cells if cell.column in ("ma", "bim")]
    return Table("budget", tuple(cells), pictures=tuple(pictures))


def factors(config: SuiteConfig) -> Table:
    """Paper, figure 6: rotation, and the factor alpha by which the picture is enlarged on the
    screen."""
    scenes = {}
    for roll in ROLL_ANGLES:
        rolled = partial(with_values, values={"view.roll": float(roll)})
        scenes[f"roll_{roll}"] = map_scenes(config.scene, rolled)
    # at odd multiples a point-sampled photo reads one sensor pixel, at even ones the mean of two,
    # which is a filter
    is_point_sampled = any(scene.develop.resize == "point" for scene in scenes_of(config.scene))
    for alpha in (1, 3, 5) if is_point_sampled else (1, 2, 3):
        scenes[f"alpha_{alpha}"] = map_scenes(config.scene, partial(_enlarged, alpha=alpha))
    columns: dict[str, Condition] = {
        "no_moire": PhotoWithoutMoire(),
        "moire": Photo(),
        "random": RandomNoise(eps=config.middle),
        "ma": MoireAttacker(eps=config.middle, steps=config.steps),
    }
    cells: list[Cell] = []
    for name, scene in scenes.items():
        cells += undefended_row(name, {key: c.at(name, scene) for key, c in columns.items()})
    return Table("factors", tuple(cells), pictures=tuple((name, "moire") for name in scenes))


def _enlarged(scene: Scene, alpha: float) -> Scene:
    """Return a scene that shows the image `alpha` times as large.

    Where `panel.width` is given, that width counts as alpha = 2 and is scaled by alpha / 2; the
    sensor stays. So is the `sensor.shrink` of a crop, and a panel pixel stays as many sensor pixels
    wide. Otherwise an image pixel becomes `alpha` panel pixels wide, at the middle of the range of
    `panel.scale`, and the sensor's scale grows alike, so that a panel pixel stays as wide, too.
    """
    low, high = bounds(scene.panel.width)
    if high:
        return with_values(scene, {"panel.width": (low * alpha / 2, high * alpha / 2)})
    if scene.is_crop:
        low, high = bounds(scene.sensor.shrink)
        return with_values(scene, {"sensor.shrink": (low * alpha / 2, high * alpha / 2)})
    low, high = bounds(scene.panel.scale)
    factor = alpha / ((low + high) / 2)
    scales = {"panel.scale": (low * factor, high * factor)}
    return with_values(scene, scales | {"sensor.scale": scene.sensor.scale * factor})


def noise_position(config: SuiteConfig) -> Table:
    """Paper, appendix E: noise on the raw reading against noise on the developed photo ("Moiré +
    BIM")."""
    eps, steps = config.middle, config.steps
    columns = controls(eps)
    columns["ma"] = MoireAttacker(eps=eps, steps=steps, until_fooled=False)
    columns["moire_bim"] = MoireAttacker(
        eps=eps,
        steps=steps,
        variant="noise_on_the_photo",
        noise_at="photo",
        until_fooled=False,
    )
    classifiers = {"undefended": UNDEFENDED}
    for quality in (20, 40):
        classifiers[f"jpeg_{quality}"] = config.behind(f"jpeg_{quality}")
    return Table("noise_position", tuple(cross(classifiers, columns)))


def appearance(config: SuiteConfig) -> Table:
    """Paper, appendix B: the Moiré Attack beside BIM and an adversarial patch."""
    eps, steps = config.middle, config.steps
    columns: dict[str, Condition] = controls(eps) | {
        "ma": MoireAttacker(eps=eps, steps=steps, until_fooled=False),
        "bim": PixelAttacker(attack="bim", eps=eps, steps=steps, until_fooled=False),
        "patch": PixelAttacker(attack="patch", eps=Patch.eps, steps=steps, until_fooled=False),
    }
    cells = undefended_row(eps_row(eps), columns)
    pictures = [cell.place for cell in cells]
    note_values = {"area": Patch.area}
    return Table("appearance", tuple(cells), pictures=tuple(pictures), note_values=note_values)
