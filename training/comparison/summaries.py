"""Recipes summarised over their seeds: means, intervals, and which are on the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import NamedTuple

import numpy as np

from moireaug.evaluation.statistics import bootstrap, t_interval, wilson
from training.comparison.points import RATES, Point

COSTS = ("seconds", "start_seconds", "passes", "images_per_second")


class Estimate(NamedTuple):
    """A mean over seeds and its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Recipe:
    """All seeds of one recipe.

    Args:
        rates: the names of `RATES` to accuracies in [0, 1].
        gains: the same minus those of plain training with the same seeds; empty where it was not
            attacked.
        seconds, start_seconds, passes, images_per_second: means over seeds, as `Point` has them.
        relative: training with its start, over the mean of plain training with its own.
        collapsed: number of seeds whose training collapsed.
        front: no other recipe is as robust at 4/255 in less time, or more robust in the same.
    """

    name: str
    seeds: tuple[int, ...]
    rates: dict[str, Estimate]
    gains: dict[str, Estimate]
    seconds: float
    start_seconds: float
    relative: Estimate
    passes: float
    images_per_second: float
    collapsed: int
    front: bool


def rate(points: Sequence[Point], name: str) -> Estimate:
    """Return a mean accuracy with an interval over seeds and images; for a single seed, over its
    images alone (Wilson)."""
    outcomes = np.stack([point.outcomes[name] for point in points])
    mean = float(outcomes.mean())
    if len(outcomes) == 1:
        return Estimate(mean, *wilson(mean * outcomes.size, outcomes.size))
    low, high = bootstrap(outcomes)
    return Estimate(mean, max(0.0, low), high)


def gain(points: Sequence[Point], plain: Sequence[Point], name: str) -> Estimate:
    """Return a mean difference of accuracies of the same seeds, on the same images."""
    by_seed = {point.seed: point for point in plain}
    rows = []
    for point in points:
        if point.seed in by_seed:
            rows.append(point.outcomes[name] - by_seed[point.seed].outcomes[name])
    differences = np.stack(rows)
    return Estimate(float(differences.mean()), *bootstrap(differences))


def ratio(values: Sequence[float]) -> Estimate:
    """Return a mean cost with Student's interval over seeds; for a single seed it has no width."""
    if len(values) == 1:
        return Estimate(values[0], values[0], values[0])
    low, high = t_interval(values)
    return Estimate(fmean(values), max(0.0, low), high)


def pareto(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Return which (cost, gain) no other beats, better in one of both and no worse in the other."""
    found = []
    for cost, gained in points:
        beaten = False
        for other_cost, other_gain in points:
            other_is_better = other_cost < cost or other_gain > gained
            beaten = beaten or (other_cost <= cost and other_gain >= gained and other_is_better)
        found.append(not beaten)
    return found


def summarise(points: Sequence[Point]) -> list[Recipe]:
    """Return the recipes, cheapest first.

    Raises:
        ValueError: as `plain_seconds`.
    """
    by_name: dict[str, list[Point]] = {}
    for point in points:
        by_name.setdefault(point.recipe, []).append(point)
    unit = plain_seconds(points)
    rates: dict[str, dict[str, Estimate]] = {}
    costs: dict[str, Estimate] = {}
    for name, own in by_name.items():
        rates[name] = {key: rate(own, key) for key in RATES}
        costs[name] = ratio([point.total_seconds / unit for point in own])
    places = [(costs[name].value, rates[name]["worst_4"].value) for name in by_name]
    fronts = pareto(places)
    found = []
    for (name, own), front in zip(by_name.items(), fronts, strict=True):
        means = {key: fmean(getattr(point, key) for point in own) for key in COSTS}
        recipe = Recipe(
            name,
            seeds=tuple(sorted(point.seed for point in own)),
            rates=rates[name],
            gains=gains(own, by_name),
            relative=costs[name],
            collapsed=sum(point.collapsed for point in own),
            front=front,
            **means,
        )
        found.append(recipe)
    return sorted(found, key=lambda recipe: (recipe.relative.value, recipe.name))


def gains(own: Sequence[Point], by_name: dict[str, list[Point]]) -> dict[str, Estimate]:
    """Return the gains over plain training; empty where none of its runs has the same seeds."""
    plain = by_name.get(own[0].baseline or "", [])
    plain_seeds = {point.seed for point in plain}
    if not any(point.seed in plain_seeds for point in own):
        return {}
    return {key: gain(own, plain, key) for key in RATES}


def plain_seconds(points: Sequence[Point]) -> float:
    """Return the mean time of plain training, its start included; a baseline's own figure takes
    precedence over a copy.

    Raises:
        ValueError: no run says it.
    """
    by_seed: dict[int, float] = {}
    for point in points:
        if point.plain_seconds is None:
            continue
        if point.recipe == "baseline":
            by_seed[point.seed] = point.plain_seconds
        else:
            by_seed.setdefault(point.seed, point.plain_seconds)
    if not by_seed:
        raise ValueError(
            "no run says how long plain training takes, which costs are relative to: train recipe "
            "baseline with the same settings."
        )
    return fmean(by_seed.values())
