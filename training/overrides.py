"""The overrides that a re-attack accepts, and settings as overrides."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

from omegaconf import OmegaConf

from moireaug.evaluation.suites import OPTION_SUITES, check_used
from training.schema import (
    DATA,
    EPOCHS,
    HOME,
    RECIPES,
    Config,
    ReattackConfig,
    Trainer,
    as_values,
)

TRAINING = ("recipe", "seed", "adversary", "train", "resume")  # say how a model is trained
WEIGHTS = ("model", "weights", "runs")  # say which model is attacked where there is no run
OWN = (
    "recipe",
    "seed",
    "model",
    "scene",
    "data",
    "adversary",
    "train",
    "reattack",
)  # a run's, unless overridden
DEMOIRE = ("defences", "demoireing", "paper")  # suites that have a use for demoire=


def check(cfg: ReattackConfig, given: Sequence[str]) -> None:
    """Refuse overrides that a re-attack would ignore.

    Args:
        cfg: as composed. given: the overrides of the command line.

    Raises:
        ValueError: with what to do instead.
    """
    for key in keys(given):
        top = key.split(".")[0]
        if top in TRAINING or key == "data.augment":
            hint = " reattack.seed is the attack's." if top == "seed" else ""
            raise ValueError(
                f"{key}= says how a model is trained, and this one is only attacked: "
                f"leave it out.{hint}"
            )
        if top in WEIGHTS and cfg.run is not None:
            own = "its own model" if top in ("model", "weights") else "a report into its own folder"
            raise ValueError(
                f"{key}= does not go with run={cfg.run}, which has {own}: leave out one of the two."
            )
        if key == "reattack.eps" and cfg.reattack.eps is not None:
            check_used(cfg.suite, key, OPTION_SUITES["eps"])
        if top in ("targets", "networks", "lpips") and getattr(cfg, top) is not None:
            check_used(cfg.suite, top, OPTION_SUITES[top])
        if top == "demoire" and cfg.demoire is not None:
            check_used(cfg.suite, top, DEMOIRE)
        if top == "trainer" and _has_no_effect(
            key.removeprefix("trainer."), cfg.trainer, cfg.suite
        ):
            raise ValueError(
                f"{key}= has no effect here: an attack is computed in float32, "
                "and suite=ladder by one process. Leave it out."
            )


def _has_no_effect(key: str, trainer: Trainer, suite: str) -> bool:
    """Return whether a setting of the trainer would be ignored; giving its default is allowed."""
    if key == "accelerator" or not hasattr(Trainer, key):
        return False
    if getattr(trainer, key) == getattr(Trainer, key):
        return False
    return suite == "ladder" or key in ("precision", "deterministic")


def keys(given: Sequence[str]) -> list[str]:
    """Return the keys that a command line sets."""
    return [override.lstrip("+~").split("=", 1)[0] for override in given]


def onto(own: Config, cfg: ReattackConfig, given: Sequence[str]) -> ReattackConfig:
    """Return a re-attack's settings: those of the run, except for what the command line gives.

    Options that make a command import, fetch or start something come from the command line alone.

    Args:
        own: the run's settings. cfg: as composed. given: the overrides of the command line.
    """
    merged = copy.deepcopy(cfg)
    for key in OWN:
        setattr(merged, key, copy.deepcopy(getattr(own, key)))
    merged.data.download = cfg.data.download
    merged.data.workers = cfg.data.workers
    named = [key for key in keys(given) if key.split(".")[0] in OWN]
    for key in sorted(named, key=lambda key: key.count(".")):  # data= before data.root=
        outer, _, last = key.rpartition(".")
        node = attrgetter(outer)(merged) if outer else merged
        setattr(node, last, copy.deepcopy(attrgetter(key)(cfg)))
    if "data.size" not in named:
        merged.data.size = own.data.size  # what the model was trained on, whatever the data
    if cfg.suite not in OPTION_SUITES["eps"]:
        merged.reattack.eps = None  # a run's own is of its ladder
    return merged


def command_line(cfg: Config) -> list[str]:
    """Return the overrides of fit.py that give these settings."""
    recipe = RECIPES / f"{cfg.recipe}.yaml"
    layers: list[Any] = [{"recipe": cfg.recipe, "data": DATA[cfg.data.name]}]
    if cfg.data.name in EPOCHS:
        layers.append({"train": {"epochs": EPOCHS[cfg.data.name]}})
    if recipe.is_file():
        layers.append(OmegaConf.load(recipe))
    defaults = OmegaConf.merge(OmegaConf.structured(Config), *layers)
    usual = as_values(defaults)  # type: ignore[arg-type]
    found = [f"recipe={cfg.recipe}"]
    if cfg.data.name != HOME[0]:
        found.append(f"data={cfg.data.name}")
    for key, value in as_values(cfg).items():
        if not isinstance(value, dict) or key == "scene":
            if value != usual[key]:
                found.append(f"{key}={literal(value)}")
            continue
        for name, leaf in value.items():
            if leaf != usual[key][name]:
                found.append(f"{key}.{name}={literal(leaf)}")
    return found


def literal(value: Any) -> str:
    """Return a value in Hydra's grammar."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace("'", "\\'")
        return f"'{escaped}'"
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{k}:{literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(map(literal, value)) + "]"
    return repr(value)
