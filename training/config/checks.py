"""Settings checked against each other, the machine and the run that is attacked, before any time is
spent."""

import copy
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import nn

from moireaug.attacks import MoireAttack
from moireaug.evaluation.suites import check_used
from moireaug.evaluation.tables import SuiteConfig
from training.config.data_sets import DATA, Data, data_sets_with
from training.config.recipes import RECIPE_NAME
from training.config.scenes import scene_of
from training.config.schema import (
    ATTACKS,
    Adversary,
    Config,
    ReattackConfig,
    RunConfig,
    Train,
    Trainer,
)
from training.config.settings import as_argument, check, settings_of, value_of, with_values
from training.suites import OPTION_SUITES
from training.system.files import has_parts

# that a run chooses for the ladder that it ends with: other suites would be weak with few steps
LADDER_SETTINGS = ("reattack.eps", "reattack.steps", "reattack.n")


def check_classifier(cfg: Config) -> None:
    """Refuse invalid settings of a classifier's data, scene and attack."""
    check_run(cfg)
    require_used(cfg, "data")
    check_adversary(cfg.adversary)
    eps = cfg.reattack.eps
    SuiteConfig(scene=scene_of(cfg), eps=None if eps is None else tuple(eps))  # raises


def require_used(cfg: Config, *sections: str) -> None:
    """Refuse settings of these sections that the data set, the adversary or the target of training
    would not use."""
    choices = {
        "data": ("data", cfg.data.name, DATA[cfg.data.name]),
        "adversary": ("adversary.kind", cfg.adversary.kind, Adversary()),
        "train": ("train.target", cfg.train.target, Train()),
    }
    natural = {"natural"} if cfg.adversary.natural else set()
    for section in sections:
        choice, chosen, default = choices[section]
        for name, declared in settings_of(type(default)).items():
            value = as_argument(getattr(getattr(cfg, section), name))
            is_used = not declared.only_for or {chosen, *natural} & set(declared.only_for)
            if not is_used and value != as_argument(getattr(default, name)):
                raise ValueError(
                    f"{section}.{name}={value} has no effect on {choice}={chosen}: leave it out; "
                    f"it is for {' or '.join(declared.only_for)}."
                )


def check_search(cfg: Config) -> None:
    """Refuse a search of the training's adversary that its scene does not allow; a re-attack, which
    has a search of its own, may be in another scene."""
    optimise = tuple(cfg.adversary.optimise)
    MoireAttack(nn.Identity(), scene=scene_of(cfg), optimise=optimise, draws=cfg.adversary.draws)


def check_answers(cfg: Config) -> None:
    """Refuse settings with which a network cannot learn to keep its answers."""
    if cfg.weights is None:
        raise ValueError(
            f"recipe={cfg.recipe} keeps the answers of a trained network: pass weights=FILE and "
            "model=NAME."
        )
    if cfg.data.name not in data_sets_with("root"):
        raise ValueError(
            f"recipe={cfg.recipe} tunes a network on pictures like those it is for, and "
            f"{cfg.data.name} are drawn, of {cfg.data.size} px: pass data=folder data.root=DIR, "
            "any pictures, and data.size=N of the network, such as 224."
        )
    if cfg.train.init != "random":
        raise ValueError(
            f"train.init={cfg.train.init} does not go with train.target=answers, which begins with "
            "weights=: leave it out."
        )
    if not cfg.adversary.share + cfg.adversary.natural:
        raise ValueError(
            "train.target=answers has nothing to learn on clean images, which the network answers "
            "as before: pass adversary.natural=0.5, or recipe=moire_tune."
        )
    if cfg.data.class_index:
        raise ValueError(
            "data.class_index gives the classes of labels, and train.target=answers uses none: "
            "leave it out."
        )


def require_training_images(cfg: Data) -> None:
    """Refuse a folder of class folders alone, whose images are all for testing."""
    if cfg.name != "folder" or not cfg.root or not Path(cfg.root).is_dir():
        return
    if not has_parts(cfg.root):
        raise ValueError(
            f"data.root={cfg.root!r} lacks train/ or test/, so that all its images are for "
            "testing. Training needs train/<class>/ and test/<class>/ in it; to attack given "
            "weights on these images, use training/reattack.py."
        )


def check_adversary(cfg: Adversary) -> None:
    """Refuse settings of an adversary that do not go together."""
    if cfg.kind == "none" and cfg.share:
        raise ValueError(
            f"adversary.share={cfg.share} is the share of images that are attacked, and the kind "
            f"none attacks none: use {', '.join(ATTACKS)}, or adversary.natural for photos without "
            "an attack."
        )
    if cfg.kind != "none" and not (cfg.share and cfg.steps and cfg.eps):
        raise ValueError(
            f"adversary.kind={cfg.kind} needs a share, steps and eps above 0; got "
            f"{cfg.share}, {cfg.steps} and {cfg.eps}. Without an attack, the kind is none."
        )
    if cfg.share + cfg.natural > 1:
        raise ValueError(
            "adversary.share and adversary.natural are parts of one batch and must not add up to "
            f"more than 1; got {cfg.share} and {cfg.natural}."
        )


def check_run(cfg: RunConfig) -> None:
    """Refuse settings out of their bounds, a recipe that cannot name a folder, more devices than
    there are, and a trainer's other settings that cannot be used."""
    check(cfg)
    if not RECIPE_NAME.fullmatch(cfg.recipe):
        raise ValueError(
            f"recipe={cfg.recipe} cannot be the name of a run's folder: begin with a letter, a "
            "digit or _, and go on with these, . and -."
        )
    check_devices(cfg.trainer)
    if cfg.trainer.deterministic not in (True, False, "warn"):
        raise ValueError(
            f"trainer.deterministic must be true, false or warn; got {cfg.trainer.deterministic!r}."
        )


def check_devices(trainer: Trainer) -> None:
    """Refuse more devices than there are; lists of GPUs are left to Lightning."""
    kind, devices = trainer.accelerator, trainer.devices
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if kind in ("gpu", "cuda") and not gpus:
        raise ValueError(
            f"trainer.accelerator={kind} needs a GPU that CUDA can use, and there is none: "
            "pass cpu."
        )
    on_cpu = kind == "cpu" or (kind == "auto" and not gpus)
    # two processes can be tried on any machine
    available = max(2, os.cpu_count() or 1) if on_cpu else gpus
    unit = "processes (CPU cores)" if on_cpu else "GPUs, a list of them such as [0,2],"
    is_list = isinstance(devices, (list, tuple))
    if devices == "auto" or (not on_cpu and (devices == -1 or is_list)):
        return
    if type(devices) is not int or not 1 <= devices <= available:
        raise ValueError(f"trainer.devices must be 1 to {available} {unit} or auto; got {devices}.")


def check_overrides(cfg: ReattackConfig, overrides: Sequence[str]) -> None:
    """Refuse overrides that a re-attack would ignore.

    Args:
        overrides: overrides of the command line, key=value each.
    """
    table = settings_of(ReattackConfig)
    for key in keys_of(overrides):
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
        for option, suites in OPTION_SUITES.items():
            if f"{key}.".startswith(f"{option}.") and value_of(cfg, option) is not None:
                check_used(cfg.suite, option, suites)
        if top == "trainer" and _has_no_effect(key.removeprefix("trainer."), cfg):
            raise ValueError(
                f"{key}= has no effect here: an attack is computed in float32, "
                "and suite=ladder by one process. Leave it out."
            )


def _has_no_effect(key: str, cfg: ReattackConfig) -> bool:
    """Return whether a setting of the trainer would be ignored; giving its default is allowed."""
    default = getattr(Trainer, key, None)
    if key == "accelerator" or getattr(cfg.trainer, key, default) == default:
        return False
    return cfg.suite == "ladder" or key in ("precision", "deterministic")


def keys_of(overrides: Sequence[str]) -> list[str]:
    """Return the keys that a command line sets."""
    return [override.lstrip("+~").split("=", 1)[0] for override in overrides]


def merge_run_settings(
    run_cfg: Config, cfg: ReattackConfig, overrides: Sequence[str]
) -> ReattackConfig:
    """Return a re-attack's settings: those of the run, except for those of the command line.

    Options that make a command import, fetch or start something come from the command line alone,
    and so does the size of an attack by another suite than the ladder, which the run's is of.
    """
    given_keys = keys_of(overrides)
    values: dict[str, Any] = {}
    for key, declared in settings_of(Config).items():
        is_given = any(key == name or key.startswith(f"{name}.") for name in given_keys)
        is_of_ladder = key in LADDER_SETTINGS and cfg.suite != "ladder"
        if declared.from_run and declared.changes_result and not is_given and not is_of_ladder:
            values[key] = copy.deepcopy(value_of(run_cfg, key))
    if "data.size" not in given_keys:
        values["data.size"] = run_cfg.data.size  # what the model was trained on, whatever the data
    return with_values(cfg, values)
