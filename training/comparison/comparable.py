"""Whether runs and their re-attacks can be compared: what they must share, and warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from training.config.schema import Config
from training.config.settings import settings_of
from training.runs.run import PLAIN_RECIPES
from training.system.messages import counted

Metrics = dict[str, Any]


def data_name(metrics: Iterable[Metrics]) -> str:
    """Return the data set's name; for a folder its own, if all runs have the same."""
    sets = [m["config"]["data"] for m in metrics]
    own = {Path(data["root"]).resolve().name for data in sets if data["name"] == "folder"}
    return own.pop() if len(own) == 1 else sets[0]["name"]


def images(metrics: Metrics) -> Metrics:
    """Return the settings of the data that its test images depend on."""
    data = metrics["config"]["data"]
    found = {name: data.get(name) for name in ("name", "size", "test", "class_index")}
    if data["name"] == "folder":  # other data sets are the same wherever they lie
        found["root"] = data["root"]
    return found


def settings(metrics: Metrics) -> Metrics:
    """Return what the runs of a table must share."""
    found = {
        "model": metrics["model"],
        "weights": metrics["config"].get("weights"),
        "scene": metrics["scene_name"],
    }
    for key, one in settings_of(Config).items():
        part, _, name = key.partition(".")
        if part in ("data", "train") and not one.facts.may_differ:
            found[key] = metrics["config"][part].get(name)
    scene = metrics["scene"]  # or, of a mixture, a list
    for number, one in enumerate(scene if isinstance(scene, list) else [scene], 1):
        mark = f"scene {number}" if isinstance(scene, list) else "scene"
        for name, value in one.items():
            found[f"{mark}.{name}"] = value
    return found


def training(metrics: Metrics) -> Metrics:
    """Return what the seeds of one recipe must share."""
    found: Metrics = {}
    for part in ("adversary", "train"):
        for name, value in metrics["config"][part].items():
            found[f"{part}.{name}"] = value
    return found


def baseline(metrics: Metrics, trained: Iterable[Metrics]) -> str | None:
    """Return the recipe of plain training that a run is compared with; None for plain training
    itself, and where it took fewer epochs than the run or had another start."""
    if metrics["recipe"] in PLAIN_RECIPES:
        return None
    for other in trained:
        if other["recipe"] == "baseline" and not _fair(other, metrics):
            return None
    return "baseline"


def _fair(plain: Metrics, metrics: Metrics) -> bool:
    same_start = plain["train"]["init"] == metrics["train"]["init"]
    return bool(same_start and _epochs(plain) >= _epochs(metrics))


def _epochs(metrics: Metrics) -> float:
    train = metrics["config"]["train"]
    return float(train["epochs"] * train.get("length", 1.0))


def attackers(again: Metrics) -> Metrics:
    """Return the attackers of a re-attack's worst case, which differ between versions."""
    lines = again["tables"]["worst_case"]
    return {"attackers": sorted({line["column"] for line in lines})}


def protocol(again: Metrics) -> Metrics:
    """Return what the re-attacks of a table must share, by setting."""
    return {
        "reattack.n": again["n"],
        "reattack.steps": again["steps"],
        "reattack.seed": again["config"]["reattack"]["seed"],
        "reattack.batch_size": again["config"]["reattack"].get("batch_size"),
    }


def same_training(trained: Mapping[Path, Metrics]) -> Metrics:
    """Return the settings that all runs of a table share.

    Raises:
        ValueError: as `same`, of the runs or of the seeds of one recipe.
    """
    of_all: dict[Path, Metrics] = {}
    of_recipes: dict[str, dict[Path, Metrics]] = {}
    for folder, metrics in trained.items():
        of_all[folder] = settings(metrics)
        of_recipes.setdefault(metrics["recipe"], {})[folder] = training(metrics)
    shared = same(of_all, "runs")
    for recipe, of_seeds in sorted(of_recipes.items()):
        same(of_seeds, f"seeds of {recipe}")
    return shared


def same_attack(attacked: Mapping[Path, Metrics]) -> Metrics:
    """Return the protocol that all re-attacks of a table share; empty where there are none.

    Raises:
        ValueError: as `same`, of the protocol or of the attackers.
    """
    protocols, worst = {}, {}
    for folder, again in attacked.items():
        protocols[folder] = protocol(again)
        worst[folder] = attackers(again)
    shared = same(protocols, "re-attacks")
    same(worst, "re-attacks")
    return shared


def same(every: Mapping[Path, Metrics], what: str) -> Metrics:
    """Return what all of them share; empty where there are none.

    Raises:
        ValueError: one differs from most; it is named, with what differs.
    """
    shared: Metrics = {}
    for key in sorted({key for own in every.values() for key in own}):
        values = {folder: own.get(key) for folder, own in every.items()}
        usual = Counter(map(_written, values.values())).most_common(1)[0][0]
        for folder, value in values.items():
            if _written(value) != usual:
                raise ValueError(
                    f"{what} with different {key} cannot be compared: {folder} has "
                    f"{_written(value)}, most others have {usual}. Repeat it with the same, or "
                    "move it to another folder."
                )
            shared[key] = value
    return shared


def _written(value: Any) -> str:
    """Return a value as a command line takes it."""
    return "null" if value is None else repr(value)


def warnings(trained: Mapping[Path, Metrics], attacked: Mapping[Path, Metrics]) -> list[str]:
    """Return what a reader must know before trusting the figures."""
    found = []
    machines = _machines(trained, attacked)
    if len(machines) > 1:
        named = "; ".join(machines)
        found.append(
            f"The runs were trained in different ways ({named}): do not compare their times."
        )
    found += _unshared_seeds(trained, attacked)
    unpaired = []
    for metrics in trained.values():
        recipe = metrics["recipe"]
        if recipe in PLAIN_RECIPES or recipe in unpaired:
            continue
        if baseline(metrics, trained.values()) is None:
            unpaired.append(recipe)
    for recipe in unpaired:
        found.append(
            f"No gain is given for {recipe}: baseline was trained for fewer epochs, or from "
            "another start. Train it with the same train.epochs and train.init."
        )
    for folder, again in attacked.items():
        failed = []
        for check in again.get("trust") or []:
            if check["verdict"] == "fail":
                failed.append(check["name"])
        if failed:
            found.append(f"Checks of the attack failed on {folder}: {'; '.join(failed)}.")
    return found


def _machines(trained: Mapping[Path, Metrics], attacked: Mapping[Path, Metrics]) -> list[str]:
    """Return what was trained on, of every run whose time counts: those attacked, the plain ones
    and those beside them."""
    found = set()
    for folder, metrics in trained.items():
        if folder in attacked or metrics["recipe"] in PLAIN_RECIPES:
            found.add(_machine(metrics))
        for role in ("start", "baseline"):
            beside = metrics.get(role) or {}
            if folder in attacked and "environment" in beside:
                found.add(_machine({**metrics, "environment": beside["environment"]}))
    return sorted(found)


def _unshared_seeds(trained: Mapping[Path, Metrics], attacked: Mapping[Path, Metrics]) -> list[str]:
    """Return a sentence for each recipe that has a seed which plain training has not."""
    seeds: dict[str, set[int]] = {}
    plain: dict[str, str | None] = {}
    for folder in attacked:
        metrics = trained[folder]
        seeds.setdefault(metrics["recipe"], set()).add(metrics["seed"])
        plain[metrics["recipe"]] = baseline(metrics, trained.values())
    found = []
    for recipe, own in seeds.items():
        theirs = seeds.get(plain[recipe] or "", set())
        shared, lone = own & theirs, own - theirs
        if shared and lone:
            said = f"The gain of {recipe} is over {_numbered(shared)} alone: {plain[recipe]} was "
            found.append(f"{said}not trained and attacked with {_numbered(lone)}.")
    return found


def _numbered(seeds: set[int]) -> str:
    word = "seed" if len(seeds) == 1 else "seeds"
    return f"{word} {', '.join(map(str, sorted(seeds)))}"


def _machine(metrics: Metrics) -> str:
    """Return what a run was trained on, and in which precision if one was set."""
    environment, trainer = metrics["environment"], metrics["config"].get("trainer") or {}
    said = environment["device"]
    if said == "cpu":
        said = f"{environment['cpu']}, {counted(environment['threads'], 'thread')}"
    for name, usual in (("devices", 1), ("num_nodes", 1), ("precision", None)):
        if trainer.get(name, usual) != usual:
            said += f", {name}={trainer[name]}"
    return said
