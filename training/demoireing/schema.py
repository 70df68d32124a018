"""Every setting of a run that trains a demoiréing network; its recipes are in
`recipes/demoireing/`.

Durations are in steps, sizes in pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore

from training.schema import QUIET, RECIPES, SILENT, RunConfig, help_of, store_recipes

OWN = RECIPES / "demoireing"
PICTURES = ("signs", "folder")  # data sets that come in any size

# what phones in front of LCDs and OLEDs take
SEEN = ("screen_photo", "phone_at_monitor", "phone_at_laptop", "phone_at_phone")
UNSEEN = ("phone_at_television", "webcam_at_phone", "phone_at_led_wall")


@dataclass
class Demoire:
    """What the network is, and what it learns."""

    # "twin": the same shot without moiré. "original": what the screen showed. "toned": the original
    # under the linear colour map that brings it closest to the photo, so that the exposure stays
    target: str = "twin"
    width: float = 0.25  # factor of the published numbers of channels
    # a state_dict of torchvision's vgg16, for the perceptual part of a published loss; null: none
    vgg: str | None = None


@dataclass
class Train:
    """How the weights are trained."""

    steps: int = 600
    check_every: int = 50  # steps from one validation to the next; each can be resumed from
    batch_size: int = 4  # of all devices together
    lr: float = 1e-3  # the peak; falls to 0 along half a cosine
    warmup: int = 50  # steps over which it rises
    ema: float = 0.99  # decay per step of the averaged weights, which are validated and kept
    channels_last: bool = True


@dataclass
class HeldOut:
    """What the trained network is tested on."""

    size: int = 256  # side of the pairs
    unseen: list[str] = field(default_factory=lambda: list(UNSEEN))  # scenes not trained in


@dataclass
class DemoireConfig(RunConfig):
    """All settings of a run. In `data`, `size` is the side of the training crops, `val` the number
    of validation pairs, and `test` the number of test pairs per scene."""

    # one scene, or several that take turns: as in `Config`, or a list of them
    scene: Any = field(default_factory=lambda: list(SEEN))
    model: str = "esdnet"  # or any of moireaug.defenses.demoire.NETWORKS
    # `weights`: a file of moireaug.defenses.demoire.save to start from
    demoire: Demoire = field(default_factory=Demoire)
    train: Train = field(default_factory=Train)
    test: HeldOut = field(default_factory=HeldOut)
    # real photos and what was on the screen, for the report: as training/calibrate.py takes them
    pairs: str | None = None


def names() -> list[str]:
    """Return the recipes that train a demoiréing network."""
    return sorted(path.stem for path in OWN.glob("*.yaml"))


def asked_for(overrides: Sequence[str]) -> bool:
    """Return whether a command line names such a recipe.

    Raises:
        SystemExit: it also names recipes of classifiers.
    """
    given: list[str] = []
    for override in overrides:
        key, _, value = override.partition("=")
        if key == "recipe":
            given = value.split(",")
    ours = [name for name in given if name in names()]
    if ours and len(ours) < len(given):
        raise SystemExit(
            f"error: recipe={','.join(given)} mixes recipes of two kinds: {', '.join(ours)} trains "
            "a demoiréing network. Use two commands."
        )
    return bool(ours)


def register() -> None:
    """Register the schema and the recipes with Hydra."""
    store = ConfigStore.instance()
    store.store(name="demoire_schema", node=DemoireConfig)
    store_recipes(OWN)
    defaults = ["demoire_schema", {"data": PICTURES[0]}, {"recipe": "demoire"}, "_self_"]
    store.store(
        name="demoire",
        node={"defaults": [*defaults, *SILENT], "hydra": QUIET | help_of("demoireing/fit.py")},
    )
