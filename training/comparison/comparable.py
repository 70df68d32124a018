"""Whether runs and their re-attacks can be compared: the settings that they must share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from training.config.overrides import literal
from training.config.schema import Config
from training.config.settings import settings_of
from training.runs.metrics import Metrics, RunMetrics, SuiteMetrics
from training.runs.run import PLAIN_RECIPES

Settings = dict[str, Any]


def shared_training(trained: Mapping[Path, RunMetrics]) -> Settings:
    """Return the settings that all runs of a table share.

    Raises:
        ValueError: as `shared_values`, of the runs or of the seeds of one recipe.
    """
    of_runs: dict[Path, Settings] = {}
    of_recipes: dict[str, dict[Path, Settings]] = {}
    for folder, metrics in trained.items():
        of_runs[folder] = run_settings(metrics)
        of_recipes.setdefault(metrics.recipe, {})[folder] = recipe_settings(metrics)
    shared = shared_values(of_runs, "runs")
    for recipe, of_seeds in sorted(of_recipes.items()):
        shared_values(of_seeds, f"seeds of {recipe}")
    return shared


def shared_protocol(attacked: Mapping[Path, SuiteMetrics]) -> Settings:
    """Return the protocol that all re-attacks of a table share; empty where there are none.

    Raises:
        ValueError: as `shared_values`, of the protocol or of the attackers.
    """
    protocols, attackers = {}, {}
    for folder, attack in attacked.items():
        protocols[folder] = protocol_settings(attack)
        attackers[folder] = worst_case_attackers(attack)
    shared = shared_values(protocols, "re-attacks")
    shared_values(attackers, "re-attacks")
    return shared


def shared_values(settings_by_run: Mapping[Path, Settings], noun: str) -> Settings:
    """Return the settings that all runs share; empty where there are no runs.

    Args:
        settings_by_run: settings of each run, by its folder.
        noun: name of the runs in the error message, in the plural.

    Raises:
        ValueError: one differs from most; names it and the setting that differs.
    """
    shared: Settings = {}
    for key in sorted({key for settings in settings_by_run.values() for key in settings}):
        values = {folder: settings.get(key) for folder, settings in settings_by_run.items()}
        most_common = Counter(map(literal, values.values())).most_common(1)[0][0]
        for folder, value in values.items():
            if literal(value) != most_common:
                raise ValueError(
                    f"{noun} with different {key} cannot be compared: {folder} has "
                    f"{literal(value)}, most others have {most_common}. Repeat it with the same, "
                    "or move it to another folder."
                )
            shared[key] = value
    return shared


def run_settings(metrics: RunMetrics) -> Settings:
    """Return the settings that the runs of a table must share."""
    settings = {
        "model": metrics.model,
        "weights": metrics.config["weights"],
        "scene": metrics.scene_name,
    }
    for key, declared in settings_of(Config).items():
        part, _, name = key.partition(".")
        if part in ("data", "train") and not declared.facts.may_differ:
            settings[key] = metrics.config[part][name]
    scene = metrics.scene  # or, of a mixture, a list
    for number, one in enumerate(scene if isinstance(scene, list) else [scene], 1):
        prefix = f"scene {number}" if isinstance(scene, list) else "scene"
        for name, value in one.items():
            settings[f"{prefix}.{name}"] = value
    return settings


def recipe_settings(metrics: RunMetrics) -> Settings:
    """Return the settings that the seeds of one recipe must share."""
    settings: Settings = {}
    for part in ("adversary", "train"):
        for name, value in metrics.config[part].items():
            settings[f"{part}.{name}"] = value
    return settings


def image_settings(metrics: Metrics) -> Settings:
    """Return the settings of the data that its test images depend on."""
    data = metrics.config["data"]
    settings = {name: data[name] for name in ("name", "size", "test", "class_index")}
    if data["name"] == "folder":  # other data sets are the same in any folder
        settings["root"] = data["root"]
    return settings


def protocol_settings(attack: SuiteMetrics) -> Settings:
    """Return the settings that the re-attacks of a table must share.

    Args:
        attack: metrics of a re-attack.
    """
    return {
        "reattack.n": attack.n,
        "reattack.steps": attack.steps,
        "reattack.seed": attack.config["reattack"]["seed"],
        "reattack.batch_size": attack.config["reattack"]["batch_size"],
    }


def worst_case_attackers(attack: SuiteMetrics) -> Settings:
    """Return the attackers of a re-attack's worst case, which differ between versions."""
    cells = attack.tables["worst_case"]
    return {"attackers": sorted({cell["column"] for cell in cells})}


def data_name(metrics: Iterable[RunMetrics]) -> str:
    """Return the name of the data set, or of its folder if all runs have the same."""
    data_sets = [m.config["data"] for m in metrics]
    folders = {Path(data["root"]).resolve().name for data in data_sets if data["name"] == "folder"}
    return folders.pop() if len(folders) == 1 else data_sets[0]["name"]


def baseline_recipe(metrics: RunMetrics, trained: Iterable[RunMetrics]) -> str | None:
    """Return the recipe of plain training that a run is compared with; None for plain training
    itself, and where it took fewer epochs than the run or had another start."""
    if metrics.recipe in PLAIN_RECIPES:
        return None
    for other in trained:
        if other.recipe == "baseline" and not _is_fair(other, metrics):
            return None
    return "baseline"


def _is_fair(baseline: RunMetrics, metrics: RunMetrics) -> bool:
    theirs, ours = baseline.config["train"], metrics.config["train"]
    same_start = theirs["init"] == ours["init"]
    return same_start and theirs["epochs"] * theirs["length"] >= ours["epochs"] * ours["length"]
