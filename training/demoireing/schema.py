"""Every setting of a run that trains a demoiréing network.

Durations are in steps, sizes in pixels.
"""

from dataclasses import dataclass
from typing import Any

from moireaug.synthesis.pairs import SIZE_RANGE
from training.config.schema import SHRINK_HELP, RunConfig
from training.config.settings import section, setting

# what phones in front of LCDs and OLEDs take
TRAINED_SCENES = ("screen_photo", "phone_at_monitor", "phone_at_laptop", "phone_at_phone")
UNSEEN_SCENES = ("phone_at_television", "webcam_at_phone", "phone_at_led_wall")


@dataclass
class Pictures:
    """The pictures that are photographed."""

    root: str | None = setting(
        None,
        "folder of pictures, a tenth for validation and for tests, or with train/ and test/; null: "
        "drawn",
        is_path=True,
    )
    size: int = setting(128, "side of the training crops", bounds=SIZE_RANGE)
    subsample: int = setting(
        3,
        "training photos are up to this much larger, then shrunk unfiltered",
        bounds=(1, 8),
    )
    jpeg: int | None = setting(
        60, "lowest JPEG quality of training photos; null: no JPEG", bounds=(1, 100)
    )
    pairs: int = setting(2000, "training pairs, also turned and mirrored", bounds=(1, None))
    candidates: int = setting(
        2,
        "pairs to choose from, the strongest in coarse colour",
        bounds=(1, None),
    )
    val: int = setting(32, "validation pairs", bounds=(1, None))
    test: int = setting(16, "test pairs of each scene", bounds=(1, None), tests=True)
    workers: int = setting(0, "processes that make pairs", bounds=(0, 1024), changes_result=False)

    @property
    def name(self) -> str:
        """The data set: a folder, or drawn pictures."""
        return "folder" if self.root else "drawn"


@dataclass
class Demoire:
    """The network and its target."""

    target: str = setting(
        "clean",
        "photo without moiré (twin) and noise (clean), or what the screen showed (original)",
        choices=("clean", "twin", "original"),
    )
    width: float = setting(0.25, "factor on the published channels")
    vgg: str | None = setting(None, "weights of vgg16, for a perceptual loss", is_path=True)


@dataclass
class Train:
    """How the weights are trained."""

    steps: int = setting(2000, "in all", bounds=(1, None))
    check_every: int = setting(100, "steps between validations", bounds=(1, None))
    batch_size: int = setting(4, "over all devices", bounds=(1, None))
    lr: float = setting(0.02, "peak of Muon; falls by a cosine", bounds=(1e-8, 10))
    warmup: int = setting(50, "steps over which it rises", bounds=(0, None))
    ema: float = setting(0.99, "decay per step of the averaged weights", bounds=(0, 0.999999))


@dataclass
class TestPairs:
    """The pairs that test the trained network."""

    size: int = setting(256, "side of the pairs", bounds=SIZE_RANGE)
    unseen: list[str] = setting(
        lambda: list(UNSEEN_SCENES),
        "scenes not trained in",
        example="[phone_at_television]",
    )


@dataclass
class DemoireConfig(RunConfig):
    """All settings of a run."""

    recipe: str = setting("demoire", "name for the run's folder")
    scene: Any = setting(
        lambda: list(TRAINED_SCENES),
        "those of a list take turns",
        example="[screen_photo, phone_at_phone]",
    )
    shrink: Any = setting(lambda: [1.0, 3.0], SHRINK_HELP, example="[1,3]")
    model: str = setting("esdnet", "one of moireaug.defenses.demoire.NETWORKS")
    weights: str | None = setting(None, "file of weights to start from", is_path=True)
    data: Pictures = section(Pictures)
    demoire: Demoire = section(Demoire)
    train: Train = section(Train)
    test: TestPairs = section(TestPairs, tests=True)
    pairs: str | None = setting(
        None,
        "real photos and originals for the report, as for calibrate.py",
        is_path=True,
        changes_result=False,
    )
