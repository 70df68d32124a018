"""Warnings beside a table of runs, on figures that a reader should not trust."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from training.comparison.comparable import baseline_recipe
from training.runs.metrics import RunMetrics, SuiteMetrics
from training.runs.run import PLAIN_RECIPES
from training.system.messages import count_text

Runs = Mapping[Path, RunMetrics]
Attacks = Mapping[Path, SuiteMetrics]


def caveats(trained: Runs, attacked: Attacks) -> list[str]:
    """Return the warnings beside a table, each a sentence.

    Args:
        trained: metrics of the runs, by their folders.
        attacked: metrics of their re-attacks, by the same folders.
    """
    return [
        *_different_machines(trained, attacked),
        *_unshared_seeds(trained, attacked),
        *_missing_gains(trained),
        *_failed_checks(attacked),
    ]


def _different_machines(trained: Runs, attacked: Attacks) -> list[str]:
    machines = _machines(trained, attacked)
    if len(machines) < 2:
        return []
    names = "; ".join(machines)
    return [f"The runs were trained in different ways ({names}): do not compare their times."]


def _machines(trained: Runs, attacked: Attacks) -> list[str]:
    """Return the machines of every run whose time counts: those attacked, the plain ones and those
    beside them."""
    machines = set()
    for folder, metrics in trained.items():
        if folder in attacked or metrics.recipe in PLAIN_RECIPES:
            machines.add(_machine(metrics.environment, metrics.config["trainer"]))
        for beside in (metrics.start, metrics.baseline):
            if folder in attacked and beside and beside.environment:
                machines.add(_machine(beside.environment, metrics.config["trainer"]))
    return sorted(machines)


def _machine(environment: Mapping[str, Any], trainer: Mapping[str, Any]) -> str:
    """Return the machine of a run, and its precision if one was set."""
    machine = environment["device"]
    if machine == "cpu":
        machine = f"{environment['cpu']}, {count_text(environment['threads'], 'thread')}"
    for name, default in (("devices", 1), ("num_nodes", 1), ("precision", None)):
        if trainer[name] != default:
            machine += f", {name}={trainer[name]}"
    return machine


def _unshared_seeds(trained: Runs, attacked: Attacks) -> list[str]:
    """Return a sentence for each recipe with seeds that plain training lacks."""
    seeds: dict[str, set[int]] = {}
    baselines: dict[str, str | None] = {}
    for folder in attacked:
        metrics = trained[folder]
        seeds.setdefault(metrics.recipe, set()).add(metrics.seed)
        baselines[metrics.recipe] = baseline_recipe(metrics, trained.values())
    sentences = []
    for recipe, recipe_seeds in seeds.items():
        baseline = baselines[recipe]
        baseline_seeds = seeds.get(baseline or "", set())
        shared, lone = recipe_seeds & baseline_seeds, recipe_seeds - baseline_seeds
        if shared and lone:
            sentences.append(
                f"The gain of {recipe} is over {_numbered(shared)} alone: {baseline} was not "
                f"trained and attacked with {_numbered(lone)}."
            )
    return sentences


def _numbered(seeds: set[int]) -> str:
    noun = "seed" if len(seeds) == 1 else "seeds"
    return f"{noun} {', '.join(map(str, sorted(seeds)))}"


def _missing_gains(trained: Runs) -> list[str]:
    """Return a sentence for each recipe that has no baseline to be compared with."""
    recipes: dict[str, None] = {}
    for metrics in trained.values():
        recipe = metrics.recipe
        if recipe in PLAIN_RECIPES or recipe in recipes:
            continue
        if baseline_recipe(metrics, trained.values()) is None:
            recipes[recipe] = None
    sentences = []
    for recipe in recipes:
        sentences.append(
            f"No gain is given for {recipe}: baseline was trained for fewer epochs, or from "
            "another start. Train it with the same train.epochs and train.init."
        )
    return sentences


def _failed_checks(attacked: Attacks) -> list[str]:
    sentences = []
    for folder, attack in attacked.items():
        names = []
        for check in attack.trust or []:
            if check["verdict"] == "fail":
                names.append(check["name"])
        if names:
            sentences.append(f"Checks of the attack failed on {folder}: {'; '.join(names)}.")
    return sentences
