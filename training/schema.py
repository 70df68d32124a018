"""Every setting of a run, its type and its default; `recipes/` holds what differs.

Durations are in epochs, eps in [0, 1] units, sizes in pixels.
"""

from __future__ import annotations

import ast
import os
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from moireaug.mixtures import Mixture, as_scenes
from moireaug.scenes import Scene

RECIPES = Path(__file__).resolve().parents[1] / "recipes"
Settings = TypeVar("Settings", bound="RunConfig")


@dataclass
class Data:
    """Which images, of what size, and how many."""

    name: str = MISSING
    # folder: holds train/ and test/, or class folders alone (then all of it is test data)
    root: str | None = None
    # images are resized to size x size: the larger, the less of a photo is lost in the lens's blur
    size: int = 64
    train: int | None = None  # images; null is all there are
    val: int | None = None  # null is a tenth of the training images; for signs, its default
    test: int | None = None
    # folder: CSV of folder (or wnid) and class_index among the 1000 of published weights
    class_index: str | None = None
    augment: str = "none"  # "none", "shift", "shift_flip" or "affine": see augmentation.py
    workers: int = 0
    download: bool = False  # torchvision's own sets


DATA = {
    "signs": Data(name="signs", size=48, train=12000, val=320, test=1600),
    "cifar10": Data(name="cifar10", root="data", augment="shift_flip"),
    "cifar100": Data(name="cifar100", root="data", augment="shift_flip"),
    "gtsrb": Data(name="gtsrb", root="data", augment="affine"),
    "folder": Data(name="folder", augment="shift"),
}


EPOCHS = {"signs": 5}  # of a classifier's training, where `Train` says otherwise


@dataclass
class Adversary:
    """What is done to the training images; `adversaries.passes` gives the cost."""

    kind: str = "none"  # none, moire_attack (noise on a photo's reading) or pgd (on the pixels)
    share: float = 0.0  # of each batch that is attacked
    natural: float = 0.0  # of each batch that is photographed and not attacked
    eps: float = 0.0
    steps: int = 0
    warmup: float = 0.0  # share of training over which eps rises from 0


@dataclass
class Train:
    """How the weights are trained."""

    epochs: int = 30  # 5 for signs, see `EPOCHS`
    length: float = 1.0  # share of `epochs` that this recipe takes; the baseline takes all
    batch_size: int = 64  # of all devices together
    # null: 0.02, of Muon; with `weights`, 0.002 for a batch of 128, in proportion, of SGD
    # (tuning.py)
    lr: float | None = None
    # the peak of the one-cycle schedule, which falls by 0.1 and rises back
    momentum: float = 0.95
    weight_decay: float | None = None  # null: 0.05; with `weights`, 5e-4
    label_smoothing: float = 0.0
    # "random", or "clean": start from the weights of recipe clean, trained with the same settings
    init: str = "random"
    # decay per step of the averaged weights, which are validated and kept; null: 0.98
    ema: float | None = None
    # used and updated by batch normalisation; null: unless `weights` are given, whose own stay
    batch_statistics: bool | None = None
    channels_last: bool = True
    compile: bool = False  # torch.compile of the model


@dataclass
class Trainer:
    """Passed to lightning.Trainer unchanged, except for null."""

    accelerator: str = "auto"
    devices: Any = 1
    num_nodes: int = 1
    strategy: str = "auto"
    # null: bf16-mixed for classifiers where the hardware multiplies bfloat16, else 32-true. The
    # camera computes in float32 whatever is set, and so does every re-attack.
    precision: Any = None
    # true is refused by CUDA's bilinear resampling; a CPU run is exact anyway
    deterministic: Any = False


@dataclass
class Reattack:
    """How a trained model is attacked again."""

    n: int = 480  # test images
    batch_size: int | None = None  # null is 96, or fewer large images
    eps: list[float] | None = None  # null is the suite's own: 2, 4 and 8/255 for the ladder
    steps: int = 20
    seed: int = 1234


@dataclass
class RunConfig:
    """The settings that every run has, whatever it trains."""

    recipe: str = MISSING
    seed: int = 0
    runs: str = "runs"
    # a preset's name, or a mapping of Scene's fields with an optional `preset`, or a list of these,
    # of which one is drawn per image; on a command line also a YAML file of such a mapping or list
    scene: Any = "screen_photo"
    model: str = MISSING
    weights: str | None = None  # a state_dict file, or torchvision's name of weights
    data: Data = field(default_factory=Data)
    trainer: Trainer = field(default_factory=Trainer)
    # null: resume where possible; true: resume or fail; false: train again
    resume: bool | None = None


@dataclass
class Config(RunConfig):
    """All settings of a run that trains a classifier."""

    model: str = "attention_convnet"  # one of models.OWN, or any torchvision classifier
    adversary: Adversary = field(default_factory=Adversary)
    train: Train = field(default_factory=Train)
    reattack: Reattack = field(default_factory=Reattack)


@dataclass
class ReattackConfig(Config):
    """All settings of an attack on a run or on given weights."""

    recipe: str = "pretrained"
    # a run's folder; its own settings hold, except for those on the command line
    run: str | None = None
    # or one of evaluation.suites.SUITES, a group ("paper", "recipes"), "trust"
    suite: str = "ladder"
    targets: Any = None  # of transfer: name to a file of weights or a run's folder
    # of demoireing: a folder of weights FILE.pt, or name to a file of weights or a run's folder
    networks: Any = None
    # package.module:callable on (B, 3, H, W) in [0, 1], a further defence or demoiréing network
    demoire: str | None = None
    # a state_dict of torchvision's squeezenet1_1, alexnet or vgg16: LPIPS of every attack
    lpips: str | None = None


def as_config(cfg: DictConfig | Settings) -> Settings:
    """Return the settings as the dataclass they are declared as.

    Args:
        cfg: as Hydra composed it; a dataclass is returned as it is.

    Raises:
        omegaconf.errors.MissingMandatoryValue: a setting without a value.
    """
    if isinstance(cfg, DictConfig):
        return OmegaConf.to_object(cfg)  # type: ignore[return-value]
    return cfg


def absolute(cfg: Settings) -> Settings:
    """Return the settings with absolute paths of data and weights, so that runs of two projects
    that share a folder of runs are not taken for each other."""
    data = replace(cfg.data)
    if data.root:
        data.root = os.path.abspath(data.root)
    if data.class_index:
        data.class_index = os.path.abspath(data.class_index)
    weights = cfg.weights
    if weights and not weights.isidentifier():  # torchvision's names are
        weights = os.path.abspath(weights)
    return replace(cfg, data=data, weights=weights)


def as_values(cfg: DictConfig | RunConfig) -> dict[str, Any]:
    """Return the settings as plain values: dictionaries, lists, strings and numbers."""
    if isinstance(cfg, DictConfig):
        return OmegaConf.to_container(cfg, resolve=True)  # type: ignore[return-value]
    return asdict(cfg)


HOME = ("signs", Config.model)  # data and model whose runs need no folder of their own
QUIET = {"run": {"dir": "."}, "sweep": {"dir": "${runs}", "subdir": "."}, "output_subdir": None}
SILENT = [
    {"override hydra/job_logging": "none"},
    {"override hydra/hydra_logging": "none"},
]


def scene_of(cfg: Any) -> Scene | Mixture:
    """Return the scene, or the mixture, that `cfg.scene` names or describes; `cfg` has such an
    attribute."""
    scene: Any = cfg.scene
    if OmegaConf.is_config(scene):
        scene = OmegaConf.to_container(scene, resolve=True)
    return as_scenes(scene)


def help_of(script: str) -> dict[str, dict[str, str]]:
    """Return what `--help` shows: what the script's docstring says, and the settings."""
    text = ast.get_docstring(ast.parse((Path(__file__).parent / script).read_text("utf-8"))) or ""
    settings = "Settings, of which training/schema.py says what they are:\n\n$CONFIG\n"
    return {"help": {"template": f"{text.strip()}\n\n{settings}"}}


def register() -> None:
    """Register the schema, the data sets and every recipe of `recipes/` with Hydra."""
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    for name, node in DATA.items():
        store.store(group="data", name=name, node=node)
    for name, epochs in EPOCHS.items():
        store.store(group="epochs", name=name, package="train", node={"epochs": epochs})
    store_recipes(RECIPES)
    of_data = {"optional epochs": "${data}"}
    defaults = ["schema", {"data": HOME[0]}, of_data, {"recipe": "clean"}, "_self_"]
    store.store(
        name="root", node={"defaults": [*defaults, *SILENT], "hydra": QUIET | help_of("fit.py")}
    )
    store.store(name="reattack_schema", node=ReattackConfig)
    defaults = ["reattack_schema", {"data": HOME[0]}, "_self_", *SILENT]
    store.store(
        name="reattack", node={"defaults": defaults, "hydra": QUIET | help_of("reattack.py")}
    )


def store_recipes(folder: Path) -> None:
    """Register the recipes of a folder, not of its subfolders, with Hydra."""
    for path in sorted(folder.glob("*.yaml")):
        recipe = OmegaConf.merge({"recipe": path.stem}, OmegaConf.load(path))
        ConfigStore.instance().store(
            group="recipe", name=path.stem, package="_global_", node=recipe
        )
