"""The overrides that a re-attack accepts, and its settings with those of the run."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

from moireaug.evaluation.suites import OPTION_SUITES, check_used
from training.config.schema import Config, ReattackConfig, Trainer
from training.config.settings import settings_of, value_of, with_values

DEMOIRE_SUITES = ("defences", "demoireing", "paper")  # suites that have a use for demoire=


def check(cfg: ReattackConfig, overrides: Sequence[str]) -> None:
    """Refuse overrides that a re-attack would ignore.

    Args:
        cfg: the composed settings.
        overrides: overrides of the command line, key=value each.

    Raises:
        ValueError: with what to do instead.
    """
    table = settings_of(ReattackConfig)
    for key in keys(overrides):
        top = key.split(".")[0]
        # the setting of a key, or those that start with it
        settings = [one for name, one in table.items() if f"{name}.".startswith(f"{key}.")]
        if settings and all(one.trains for one in settings):
            hint = " reattack.seed is the attack's." if top == "seed" else ""
            raise ValueError(
                f"{key}= says how a model is trained, and this one is only attacked: "
                f"leave it out.{hint}"
            )
        if cfg.run is not None and settings and settings[0].run_has:
            raise ValueError(
                f"{key}= does not go with run={cfg.run}, which has {settings[0].run_has}: leave "
                "out one of the two."
            )
        if key == "reattack.eps" and cfg.reattack.eps is not None:
            check_used(cfg.suite, key, OPTION_SUITES["eps"])
        if top in ("targets", "networks", "lpips") and getattr(cfg, top) is not None:
            check_used(cfg.suite, top, OPTION_SUITES[top])
        if top == "demoire" and cfg.demoire is not None:
            check_used(cfg.suite, top, DEMOIRE_SUITES)
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
        if declared.from_run and not is_given:
            values[key] = copy.deepcopy(value_of(run_cfg, key))
    if "data.size" not in given_keys:
        values["data.size"] = run_cfg.data.size  # what the model was trained on, whatever the data
    if cfg.suite not in OPTION_SUITES["eps"]:
        values["reattack.eps"] = None  # a run's own is of its ladder
    return with_values(cfg, values)
