"""Every setting of a classifier's run, and of an attack on it; `recipes/` holds differences.

Durations are in epochs, eps in [0, 1] units, sizes in pixels.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import MISSING, DictConfig, ListConfig, OmegaConf

from moireaug.attacks.bounds import BOUNDS
from training.config.data_sets import EPOCHS_HELP, MAX_SEED, Data
from training.config.settings import require_declared, section, setting

ATTACKS = ("moire_attack", "pgd", "photographed_pgd", "pgd_on_photo")  # of training
PHOTO_ATTACKS = ("moire_attack", "photographed_pgd", "pgd_on_photo")  # that leave photos
TARGETS = ("labels", "answers")
RECIPES = Path(__file__).resolve().parents[2] / "recipes"
# weights are float32 in all of them: the average, the attack and every re-attack need that
PRECISIONS = ("32-true", "32", "bf16-mixed", "16-mixed")
# not mps: it has no float64, which the geometry needs
ACCELERATORS = ("auto", "cpu", "gpu", "cuda")
SHRINK_HELP = (
    "sensor pixels per image pixel of crops, or [low, high]; null: the scene's, or whole photos"
)
Settings = TypeVar("Settings", bound="RunConfig")


@dataclass
class Adversary:
    """What is done to the training images; `adversaries.passes` gives the cost."""

    kind: str = setting(
        "none",
        "noise on the raw image (moire_attack), the photo (pgd_on_photo), pixels (pgd), or pixels "
        "then photographed (photographed_pgd); or none",
        choices=("none", *ATTACKS),
    )
    share: float = setting(0.0, "share of each batch that is attacked", bounds=(0, 1))
    natural: float = setting(0.0, "share that is only photographed", bounds=(0, 1))
    eps: float = setting(
        0.0, "bound of the noise, in [0, 1] units", bounds=(0, 1), only_for=ATTACKS
    )
    bound: str = setting(
        "codes",
        "scale of eps: sRGB (codes), or light",
        choices=BOUNDS,
        only_for=("moire_attack",),
    )
    steps: int = setting(0, "steps of the attack", bounds=(0, 10_000), only_for=ATTACKS)
    optimise: list[str] = setting(
        lambda: ["noise"],
        "what moire_attack changes: noise and, at 3 to 10 times the cost, parts of the scene",
        example="[noise,view]",
        only_for=("moire_attack",),
    )
    draws: int = setting(
        1,
        "photos, of which moire_attack takes the worst",
        bounds=(1, 10_000),
        only_for=("moire_attack",),
    )
    warmup: float = setting(
        0.0, "share of training over which eps rises from 0", bounds=(0, 1), only_for=ATTACKS
    )
    moire: bool = setting(
        True,
        "false: photos without moiré, as a control",
        only_for=(*PHOTO_ATTACKS, "natural"),
    )


@dataclass
class Train:
    """How the weights are trained."""

    target: str = setting(
        "labels",
        "labels, or answers to clean images by the network in weights=",
        choices=TARGETS,
    )
    layers: float = setting(1.0, "share of layers trained, from the input on", bounds=(0, 1))
    kept: float = setting(
        0.97,
        "with train.target=answers, share of validation answers kept, by averaging with the old "
        "weights",
        bounds=(0, 1),
        only_for=("answers",),
    )
    epochs: int = setting(30, EPOCHS_HELP, bounds=(1, None), may_differ=True)
    length: float = setting(
        1.0,
        "share of the epochs to train",
        bounds=(0.01, 1),
        may_differ=True,
    )
    batch_size: int = setting(64, "over all devices", bounds=(1, None))
    lr: float | None = setting(
        None,
        "peak learning rate; null: 0.02 (Muon), or with weights= 0.002 per 128 images (SGD)",
        bounds=(1e-8, 10),
    )
    momentum: float = setting(0.95, "peak of a cycle; its low is 0.1 below", bounds=(0, 0.9999))
    weight_decay: float | None = setting(None, "null: 0.05; with weights=, 5e-4", bounds=(0, 1))
    init: str = setting(
        "random",
        "random, or weights of recipe clean",
        choices=("random", "clean"),
        may_differ=True,
    )
    ema: float | None = setting(
        None, "decay per step of the averaged weights; null: 0.98", bounds=(0, 0.999999)
    )
    batch_statistics: bool | None = setting(
        None, "whether to normalise by the batch's statistics; null: without weights="
    )
    compile: bool = setting(False, "torch.compile of the model")


@dataclass
class Trainer:
    """Passed to lightning.Trainer unchanged, except for null."""

    accelerator: str = setting(
        "auto", "what to train on", choices=ACCELERATORS, changes_result=False
    )
    devices: Any = setting(1, "GPUs, or processes of a CPU; or auto")
    num_nodes: int = setting(1, "machines", bounds=(1, 100_000))
    strategy: str = setting("auto", "such as ddp")
    precision: Any = setting(
        None,
        "null: bf16-mixed for classifiers where supported, else 32-true",
        choices=PRECISIONS,
    )
    deterministic: Any = setting(
        False, "CPU runs repeat anyway; CUDA's bilinear resampling refuses true"
    )


@dataclass
class Reattack:
    """How a trained model is attacked again."""

    n: int = setting(480, "test images", bounds=(1, None))
    batch_size: int | None = setting(None, "null: 96, or fewer large images", bounds=(1, None))
    eps: list[float] | None = setting(
        None,
        "bounds of the noise; null: the suite's, in the ladder 2, 4 and 8/255",
        example="[0.00784313725,0.0156862745]",
    )
    bound: str = setting("codes", "scale of eps: sRGB (codes), or light", choices=BOUNDS)
    steps: int = setting(20, "steps of each attack", bounds=(0, 100_000))
    seed: int = setting(1234, "of the images, photos and attacks", bounds=(0, MAX_SEED))


@dataclass
class RunConfig:
    """The settings that every run has, whatever it trains."""

    recipe: str = setting(MISSING, "file of recipes/, without .yaml", trains=True)
    seed: int = setting(0, "of the weights and of all samples", bounds=(0, MAX_SEED), trains=True)
    runs: str = setting("runs", "folder of all runs", is_path=True, changes_result=False)
    scene: Any = setting(
        "screen_photo",
        "preset, YAML file, mapping of fields and `preset`, or a list of these, random per image",
        example="'{preset: paper, ...}'",
    )
    shrink: Any = setting(None, SHRINK_HELP, example="[1,3]")
    model: str = setting(MISSING, "the network's name", run_has="its own model")
    weights: str | None = setting(
        None,
        "state_dict file, or torchvision's name of weights",
        is_path=True,
        from_run=False,
        run_has="its own model",
    )
    data: Any = setting(MISSING, "which images; each kind of run says of what")
    trainer: Trainer = section(Trainer, from_run=False)
    resume: bool | None = setting(
        None,
        "null: resume where possible; true: resume or fail; false: train again",
        changes_result=False,
        trains=True,
    )


@dataclass
class Config(RunConfig):
    """All settings of a run that trains a classifier."""

    model: str = setting(
        "attention_convnet",
        "attention_convnet, attention_resnet, small_resnet, or any torchvision classifier",
        run_has="its own model",
    )
    data: Data = section(Data)
    adversary: Adversary = section(Adversary, trains=True)
    train: Train = section(Train, trains=True)
    reattack: Reattack = section(Reattack, tests=True)


@dataclass
class ReattackConfig(Config):
    """All settings of an attack on a run or on given weights."""

    recipe: str = setting("pretrained", "of the run", trains=True)
    run: str | None = setting(
        None,
        "a run's folder; its settings hold unless given here, in the ladder also reattack.n, eps "
        "and steps",
        is_path=True,
    )
    suite: str = setting(
        "ladder",
        "see docs/evaluation.md, Suites",
    )
    targets: Any = setting(
        None,
        "for transfer, trust and paper: names and files of weights, or runs",
        example="'{resnet18: FILE, ...}'",
    )
    networks: Any = setting(
        None,
        "for demoireing and paper: the same, or a folder of weights",
        example="'{mopnet: FILE, ...}'",
    )
    demoire: str | None = setting(
        None,
        "your defence, package.module:callable on images in [0, 1]; functions need an attribute "
        "identity, a text that changes with the code",
    )
    lpips: str | None = setting(
        None,
        "weights of torchvision's squeezenet1_1, alexnet or vgg16, for LPIPS",
        is_path=True,
    )


def as_config(cfg: DictConfig | ListConfig) -> Any:
    """Return the settings that Hydra composed as the dataclass they are declared as; a setting
    without a value, or one that is not declared, is refused."""
    if missing := sorted(OmegaConf.missing_keys(cfg)):
        raise ValueError(f"{missing[0]} has no value: state it in the file, as in recipe: NAME.")
    config = OmegaConf.to_object(cfg)
    require_declared(config)
    return config
