"""The overrides that a re-attack accepts, and settings as overrides."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from omegaconf import OmegaConf

from moireaug.evaluation.suites import check_used
from training.config.data_sets import DATA, DEFAULT_DATA, EPOCHS
from training.config.schema import RECIPES, Config, ReattackConfig, Trainer, as_config
from training.config.settings import Facts, settings_of, value_of, with_values
from training.suites import OPTION_SUITES


def check(cfg: ReattackConfig, overrides: Sequence[str]) -> None:
    """Refuse overrides that a re-attack would ignore.

    Args:
        cfg: the composed settings.
        overrides: overrides of the command line, key=value each.

    Raises:
        ValueError: with what to do instead.
    """
    for key in keys(overrides):
        top = key.split(".")[0]
        facts = _facts_of(key)
        if facts and all(one.trains for one in facts):
            hint = " reattack.seed is the attack's." if top == "seed" else ""
            raise ValueError(
                f"{key}= says how a model is trained, and this one is only attacked: "
                f"leave it out.{hint}"
            )
        if cfg.run is not None and facts and facts[0].run_has:
            raise ValueError(
                f"{key}= does not go with run={cfg.run}, which has {facts[0].run_has}: leave out "
                "one of the two."
            )
        if key == "reattack.eps" and cfg.reattack.eps is not None:
            check_used(cfg.suite, key, OPTION_SUITES["eps"])
        if top in ("targets", "networks", "demoire", "lpips") and getattr(cfg, top) is not None:
            check_used(cfg.suite, top, OPTION_SUITES[top])
        if top == "trainer" and _has_no_effect(
            key.removeprefix("trainer."), cfg.trainer, cfg.suite
        ):
            raise ValueError(
                f"{key}= has no effect here: an attack is computed in float32, "
                "and suite=ladder by one process. Leave it out."
            )


def _facts_of(key: str) -> list[Facts]:
    """Return the facts on the setting of a key, or on those that start with it."""
    return [
        declared.facts
        for name, declared in settings_of(ReattackConfig).items()
        if name == key or name.startswith(f"{key}.")
    ]


def _has_no_effect(key: str, trainer: Trainer, suite: str) -> bool:
    """Return whether a setting of the trainer would be ignored; giving its default is allowed."""
    if key == "accelerator" or not hasattr(Trainer, key):
        return False
    if getattr(trainer, key) == getattr(Trainer, key):
        return False
    return suite == "ladder" or key in ("precision", "deterministic")


def keys(overrides: Sequence[str]) -> list[str]:
    """Return the keys that a command line sets."""
    return [override.lstrip("+~").split("=", 1)[0] for override in overrides]


def merge_run_settings(
    run_cfg: Config, cfg: ReattackConfig, overrides: Sequence[str]
) -> ReattackConfig:
    """Return a re-attack's settings: those of the run, except for those of the command line.

    Options that make a command import, fetch or start something come from the command line alone.

    Args:
        run_cfg: settings of the run.
        cfg: the composed settings.
        overrides: overrides of the command line, key=value each.
    """
    given_keys = keys(overrides)
    values: dict[str, Any] = {}
    for key, declared in settings_of(Config).items():
        is_given = any(key == name or key.startswith(f"{name}.") for name in given_keys)
        if declared.facts.from_run and not is_given:
            values[key] = copy.deepcopy(value_of(run_cfg, key))
    if "data.size" not in given_keys:
        values["data.size"] = run_cfg.data.size  # what the model was trained on, whatever the data
    if cfg.suite not in OPTION_SUITES["eps"]:
        values["reattack.eps"] = None  # a run's own is of its ladder
    return with_values(cfg, values)


def command_line(cfg: Config) -> list[str]:
    """Return the overrides of fit.py that give these settings."""
    recipe = RECIPES / f"{cfg.recipe}.yaml"
    layers: list[Any] = [{"recipe": cfg.recipe, "data": DATA[cfg.data.name]}]
    if cfg.data.name in EPOCHS:
        layers.append({"train": {"epochs": EPOCHS[cfg.data.name]}})
    if recipe.is_file():
        layers.append(OmegaConf.load(recipe))
    merged = OmegaConf.merge(OmegaConf.structured(Config), *layers)
    default_cfg: Config = as_config(merged)
    line = [f"recipe={cfg.recipe}"]
    if cfg.data.name != DEFAULT_DATA:
        line.append(f"data={cfg.data.name}")
    for key in settings_of(Config):
        value = value_of(cfg, key)
        if value != value_of(default_cfg, key):
            line.append(f"{key}={literal(value)}")
    return line


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
