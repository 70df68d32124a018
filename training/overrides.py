"""What a command line may ask of an attack, what a run settles by itself, and settings as a command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from omegaconf import DictConfig, OmegaConf

from training.schema import DATA, HOME, RECIPES, Config, Trainer

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
)  # a run's own, beneath the command line
USES = {"targets": ("transfer", "paper", "trust"), "demoire": ("defences", "paper")}  # option to suites


def check(cfg: DictConfig, given: Sequence[str]) -> None:
    """Refuse overrides of a re-attack that would be passed over.

    Args:
        cfg: as composed. given: the overrides of the command line.

    Raises:
        ValueError: with what to do instead.
    """
    for key in keys(given):
        top = key.split(".")[0]
        if top in TRAINING or key == "data.augment":
            hint = " reattack.seed is the attack's." if top == "seed" else ""
            raise ValueError(f"{key}= says how a model is trained, and this one is only attacked: leave it out.{hint}")
        if top in WEIGHTS and cfg.run is not None:
            own = "its own model" if top in ("model", "weights") else "a report into its own folder"
            raise ValueError(f"{key}= does not go with run={cfg.run}, which has {own}: leave out one of the two.")
        if top in USES and cfg[top] is not None and cfg.suite not in USES[top]:
            raise ValueError(f"{top}= is for suite={' or '.join(USES[top])}; suite={cfg.suite} has no use for it.")
        if top == "trainer" and _useless(key.removeprefix("trainer."), cfg):
            raise ValueError(
                f"{key}= has no effect here: an attack is computed in float32, and suite=ladder by one process. Leave "
                "it out."
            )


def _useless(key: str, cfg: DictConfig) -> bool:
    """Whether a setting of the trainer would be passed over; its default may be said."""
    if key == "accelerator" or not hasattr(Trainer, key) or cfg.trainer[key] == getattr(Trainer, key):
        return False
    return cfg.suite == "ladder" or key in ("precision", "deterministic")


def keys(given: Sequence[str]) -> list[str]:
    """The keys that a command line sets."""
    return [override.lstrip("+~").split("=", 1)[0] for override in given]


def onto(own: DictConfig, cfg: DictConfig, given: Sequence[str]) -> DictConfig:
    """A re-attack's settings: those of the run, but for what the command line gives.

    Options that make a command import, fetch or start something come from the command line alone.

    Args:
        own: the run's settings. cfg: as composed. given: the overrides of the command line.
    """
    merged = OmegaConf.merge(cfg, {key: own[key] for key in OWN})
    merged.scene = own.scene
    merged.data.download = cfg.data.download
    merged.data.workers = cfg.data.workers
    names = [key for key in keys(given) if key.split(".")[0] in OWN]
    for key in sorted(names, key=lambda key: key.count(".")):  # data= before data.root=
        OmegaConf.update(merged, key, OmegaConf.select(cfg, key), merge=False)
    if "data.size" not in names:
        merged.data.size = own.data.size  # what the model was trained on, whatever the data
    return merged  # type: ignore[return-value]


def command_line(cfg: DictConfig) -> list[str]:
    """The overrides of fit.py that give these settings."""
    recipe = RECIPES / f"{cfg.recipe}.yaml"
    layers = [OmegaConf.load(recipe)] if recipe.is_file() else []
    usual = OmegaConf.merge(OmegaConf.structured(Config), {"recipe": cfg.recipe, "data": DATA[cfg.data.name]}, *layers)
    ours, usual = (OmegaConf.to_container(c, resolve=True) for c in (cfg, usual))
    found = [f"recipe={cfg.recipe}"]
    if cfg.data.name != HOME[0]:
        found.append(f"data={cfg.data.name}")
    for key, value in ours.items():
        inner = value.items() if isinstance(value, dict) and key != "scene" else [(None, value)]
        for name, leaf in inner:
            before = usual[key] if name is None else usual[key][name]
            if leaf != before:
                found.append(f"{key if name is None else f'{key}.{name}'}={_literal(leaf)}")
    return found


def _literal(value: Any) -> str:
    """A value in Hydra's grammar."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace("'", "\\'")
        return f"'{escaped}'"
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{k}:{_literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(map(_literal, value)) + "]"
    return repr(value)
