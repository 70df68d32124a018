"""Whether runs and their re-attacks can be compared: the settings that they must share, and what a
reader should not trust beside them."""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from training.config.data_sets import is_users_own
from training.config.recipes import PLAIN_RECIPES
from training.config.schema import Config, Trainer
from training.config.settings import as_argument, settings_of
from training.runs.metrics import Metrics, RunMetrics, SuiteMetrics
from training.system.messages import count_text

Settings = dict[str, Any]
Runs = Mapping[Path, RunMetrics]
Attacks = Mapping[Path, SuiteMetrics]


def require_comparable(trained: Runs, attacked: Attacks) -> None:
    """Refuse runs, seeds of one recipe or re-attacks of different settings."""
    require_shared({folder: run_settings(run) for folder, run in trained.items()}, "runs")
    seeds: dict[str, dict[Path, Settings]] = {}
    for folder, run in trained.items():
        seeds.setdefault(run.recipe, {})[folder] = recipe_settings(run)
    for recipe, settings_by_run in sorted(seeds.items()):
        require_shared(settings_by_run, f"seeds of {recipe}")
    attacks = {}
    for folder, attack in attacked.items():
        columns = {cell["column"] for cell in attack.tables["worst_case"]}
        # the attackers differ between versions
        attacks[folder] = protocol_settings(attack) | {"attackers": sorted(columns)}
    require_shared(attacks, "re-attacks")


def require_shared(settings_by_run: Mapping[Path, Settings], noun: str) -> None:
    """Refuse runs of different settings.

    Args:
        noun: name of the runs in the error message, in the plural.
    """
    for key in sorted(set().union(*settings_by_run.values())):
        values = {folder: as_argument(run.get(key)) for folder, run in settings_by_run.items()}
        most_common = Counter(values.values()).most_common(1)[0][0]
        for folder, value in values.items():
            if value != most_common:
                raise ValueError(
                    f"{noun} with different {key} cannot be compared: {folder} has {value}, most "
                    f"others have {most_common}. Repeat it with the same, or move it to another "
                    "folder."
                )


def run_settings(metrics: RunMetrics) -> Settings:
    """Return the settings that the runs of a table must share."""
    settings = {"model": metrics.model, "weights": metrics.config["weights"]}
    settings["scene"] = metrics.scene_name
    for key, declared in settings_of(Config).items():
        part, _, name = key.partition(".")
        if part in ("data", "train") and declared.changes_result and not declared.may_differ:
            settings[key] = metrics.config[part][name]
    scenes = {"scene": metrics.scene}
    if isinstance(metrics.scene, list):
        scenes = {f"scene {number}": one for number, one in enumerate(metrics.scene, 1)}
    for name, fields in scenes.items():
        settings |= prefixed(name, fields)
    return settings


def prefixed(prefix: str, settings: Mapping[str, Any]) -> Settings:
    """Return the settings of a section by their whole keys."""
    return {f"{prefix}.{name}": value for name, value in settings.items()}


def recipe_settings(metrics: RunMetrics) -> Settings:
    """Return the settings that the seeds of one recipe must share."""
    config = metrics.config
    return prefixed("adversary", config["adversary"]) | prefixed("train", config["train"])


def image_settings(metrics: Metrics) -> Settings:
    """Return the settings of the data that its test images depend on."""
    data = metrics.config["data"]
    settings = {name: data[name] for name in ("name", "size", "test", "seed", "class_index")}
    if is_users_own(data["name"]):
        settings["root"] = data["root"]
    return settings


def protocol_settings(attack: SuiteMetrics) -> Settings:
    """Return the settings of a re-attack, of which those of a table must share all."""
    settings = {name: getattr(attack, name) for name in ("n", "steps", "bound")}
    settings |= {name: attack.config["reattack"][name] for name in ("seed", "batch_size")}
    return prefixed("reattack", settings)


def data_name(metrics: Iterable[RunMetrics]) -> str:
    """Return the name of the data set, or of its folder if all runs have the same."""
    data_sets = [m.config["data"] for m in metrics]
    own = [data for data in data_sets if is_users_own(data["name"])]
    folders = {Path(data["root"]).resolve().name for data in own}
    return folders.pop() if len(folders) == 1 else data_sets[0]["name"]


def baseline_recipe(metrics: RunMetrics, trained: Iterable[RunMetrics]) -> str | None:
    """Return the recipe of plain training that a run is compared with; None for plain training
    itself, and where it took fewer epochs than the run or had another start."""
    if metrics.recipe in PLAIN_RECIPES:
        return None
    ours = metrics.config["train"]
    for theirs in [other.config["train"] for other in trained if other.recipe == "baseline"]:
        is_shorter = theirs["epochs"] * theirs["length"] < ours["epochs"] * ours["length"]
        if is_shorter or theirs["init"] != ours["init"]:
            return None
    return "baseline"


def caveats(runs: pd.DataFrame, trained: Runs, attacked: Attacks) -> list[str]:
    """Return the warnings beside a table, each a sentence."""
    sentences = []
    machines = set().union(*(_machines(trained[folder]) for folder in attacked))
    if len(machines) > 1:
        names = "; ".join(sorted(machines))
        sentences.append(
            f"The runs were trained in different ways ({names}): do not compare their times."
        )
    has_no_baseline = runs["baseline"].isna() & ~runs["recipe"].isin(PLAIN_RECIPES)
    for recipe in runs["recipe"][has_no_baseline].unique():
        sentences.append(
            f"No gain is given for {recipe}: baseline was trained for fewer epochs, or from "
            "another start. Train it with the same train.epochs and train.init."
        )
    for folder, attack in attacked.items():
        failed = [check["name"] for check in attack.trust or [] if check["verdict"] == "fail"]
        if failed:
            sentences.append(f"Checks of the attack failed on {folder}: {'; '.join(failed)}.")
    return sentences


def _machines(metrics: RunMetrics) -> set[str]:
    """Return the machines, and the precision if one was set, on which a run, its start and its
    baseline were trained."""
    settings = ""
    for name in ("devices", "num_nodes", "precision"):
        value = metrics.config["trainer"][name]
        if value != getattr(Trainer, name):
            settings += f", {name}={value}"
    machines = set()
    for run in (metrics, metrics.start, metrics.baseline):
        if run and run.environment:
            machines.add(_machine(run.environment) + settings)
    return machines


def _machine(environment: Mapping[str, Any]) -> str:
    """Return the name of a GPU, or of a CPU with its threads."""
    if environment["device"] != "cpu":
        return environment["device"]
    return f"{environment['cpu']}, {count_text(environment['threads'], 'thread')}"
