"""The paper's tables and figures, with the controls that they lack."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from moireaug.attacks import ATTACKS, Patch
from moireaug.evaluation.attackers import MoireAttacker, PixelAttacker
from moireaug.evaluation.autoattack import APGDAttacker
from moireaug.evaluation.classifiers import UNDEFENDED, Classifier, averaging_classifier
from moireaug.evaluation.conditions import (
    BrightPhotoWithoutMoire,
    Condition,
    Photo,
    PhotoWithoutMoire,
    RandomNoise,
    controls,
    in_255ths,
)
from moireaug.evaluation.tables import (
    Cell,
    SuiteConfig,
    Table,
    cross,
    eps_row,
    undefended_row,
    worst_of,
)
from moireaug.mixtures import map_scenes, scenes_of
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from moireaug.scenes import Scene
from training.suites.config import PaperConfig, PaperTable

PAPER_EPS = (2 / 255, 4 / 255, 6 / 255, 8 / 255)
BUDGET_EPS = (4 / 255, 8 / 255, 16 / 255, 32 / 255)
JPEG_QUALITIES = (20, 40, 60, 80)
NETWORKS = ("mopnet", "mddm", "fhde2net", "amnet")
DEFENCES_OF_OTHER_TABLES = (*(f"jpeg_{quality}" for quality in JPEG_QUALITIES), "gain")
ROLL_ANGLES = (0, 5, 10, 15, 30, 45)  # degrees


def moire_attacker(config: SuiteConfig, eps: float | None = None, **settings: Any) -> MoireAttacker:
    """Return the paper's Moiré Attack, which takes every step."""
    eps = config.middle if eps is None else eps
    return MoireAttacker(eps=eps, steps=config.steps, until_fooled=False, **settings)


def paper_attacks(config: SuiteConfig) -> dict[str, Condition]:
    """Return the paper's attacks at one eps, and their controls."""
    eps, steps = config.middle, config.steps
    conditions = controls(eps) | {"ma": moire_attacker(config)}
    for name in ("bim", "pgd", "cw", "mifgsm"):
        bound = eps if ATTACKS[name].has_bound else 0.0
        conditions[name] = PixelAttacker(attack=name, eps=bound, steps=steps, until_fooled=False)
    return conditions


def after_jpeg(config: SuiteConfig, qualities: Sequence[int]) -> dict[str, Classifier]:
    """Return the model alone, and behind JPEG."""
    names = [f"jpeg_{quality}" for quality in qualities]
    return {"undefended": UNDEFENDED} | {name: config.behind(name) for name in names}


def success(config: SuiteConfig) -> Table:
    """Paper, table 1: rotated, rotated and dimmed, targeted and untargeted Moiré Attacks by eps."""
    cells: list[Cell] = []
    for eps in config.bounds(PAPER_EPS):
        columns: dict[str, Condition] = {
            "rotated": BrightPhotoWithoutMoire(),
            "rotated_dim": PhotoWithoutMoire(),
            "moire": Photo(),
            "random": RandomNoise(eps=eps),
            "ma": moire_attacker(config, eps),
            "ma_targeted": moire_attacker(config, eps, targeted=True),
        }
        cells += undefended_row(eps_row(eps), columns)
    return Table("success", tuple(cells))


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
        columns[f"ma_{in_255ths(eps)}"] = moire_attacker(config, eps)
    return Table("mean_normalised", tuple(cross(classifiers, columns)))


def jpeg(config: SuiteConfig) -> Table:
    """Paper, table 3: the attacks after JPEG."""
    classifiers = after_jpeg(config, JPEG_QUALITIES)
    return Table("jpeg", tuple(cross(classifiers, paper_attacks(config))))


def defences(config: PaperConfig) -> PaperTable:
    """Paper, table 4: the attacks after other input transformations."""
    classifiers = {"undefended": UNDEFENDED}
    for name in config.defences:
        if name not in DEFENCES_OF_OTHER_TABLES:
            classifiers[name] = config.behind(name)
    cells = cross(classifiers, paper_attacks(config))
    return PaperTable("defences", tuple(cells), empty=config.without)


def demoireing(config: PaperConfig) -> PaperTable:
    """Paper, table 5: the attacks after demoiréing networks. The attackers know of none of them,
    except APGD, which goes through each network's own gradient."""
    classifiers: dict[str, Classifier] = {"undefended": UNDEFENDED}
    for name, network in config.networks.items():
        classifiers[name] = averaging_classifier(name, network)
    missing = {name: "no weights were given" for name in NETWORKS if name not in classifiers}
    eps, steps = config.middle, config.steps
    columns: dict[str, Condition] = paper_attacks(config)
    columns["ma_8"] = moire_attacker(config, PAPER_EPS[-1])
    cells = cross(classifiers, columns)
    for name, classifier in classifiers.items():
        apgd = APGDAttacker(eps=eps, steps=steps, known_classifier=classifier)
        cells.append(Cell(name, "adaptive", (apgd,), classifier))
        cells.append(worst_of([cell for cell in cells if cell.row == name], name, eps))
    return PaperTable("demoireing", tuple(cells), empty=missing)


def transfer(config: SuiteConfig) -> PaperTable:
    """Paper, table 6: the attacks on the model, classified by other models."""
    classifiers = {"attacked": UNDEFENDED}
    missing = {}
    for name, model in config.targets.items():
        if model is None:
            missing[name] = "weights not at hand"
        else:
            classifiers[name] = Classifier(name, model=model)
    return PaperTable("transfer", tuple(cross(classifiers, paper_attacks(config))), empty=missing)


def budget(config: SuiteConfig) -> Table:
    """Paper, section 4.5 and figure 4: success and visibility by eps."""
    cells: list[Cell] = []
    for eps in config.bounds(BUDGET_EPS):
        columns: dict[str, Condition] = {
            "moire": Photo(),
            "random": RandomNoise(eps=eps),
            "ma": moire_attacker(config, eps),
            "bim": PixelAttacker(attack="bim", eps=eps, steps=config.steps, until_fooled=False),
        }
        cells += undefended_row(eps_row(eps), columns)
    return Table("budget", tuple(cells))


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
    return Table("factors", tuple(cells))


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
    on_photo = moire_attacker(config, variant="noise_on_the_photo", noise_at="photo")
    columns = controls(config.middle) | {"ma": moire_attacker(config), "moire_bim": on_photo}
    return Table("noise_position", tuple(cross(after_jpeg(config, (20, 40)), columns)))


def appearance(config: SuiteConfig) -> Table:
    """Paper, appendix B: the Moiré Attack beside BIM and an adversarial patch."""
    every_step: dict[str, Any] = {"steps": config.steps, "until_fooled": False}
    columns: dict[str, Condition] = controls(config.middle) | {
        "ma": moire_attacker(config),
        "bim": PixelAttacker(attack="bim", eps=config.middle, **every_step),
        "patch": PixelAttacker(attack="patch", eps=Patch.eps, **every_step),
    }
    return Table("appearance", tuple(undefended_row(eps_row(config.middle), columns)))
