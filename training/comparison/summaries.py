"""Recipes summarised over their seeds: means, intervals and the Pareto front."""

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
class RecipeSummary:
    """The means of a recipe over its seeds.

    Args:
        name: name of the recipe.
        seeds: seeds of its runs.
        rates: accuracies in [0, 1], by the names of `RATES`.
        gains: their gains over plain training with the same seeds; empty where that was not
            attacked.
        seconds, start_seconds, passes, images_per_second: means over seeds of the fields of
            `Point`.
        relative: time of training with its start, over the mean of plain training with its own.
        collapsed: number of seeds whose training collapsed.
        front: whether no other recipe is as robust at 4/255 in less time, or more robust in the
            same.
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


def estimate_rate(points: Sequence[Point], name: str) -> Estimate:
    """Return a mean accuracy with an interval over seeds and images; for a single seed, over its
    images alone (Wilson)."""
    outcomes = np.stack([point.outcomes[name] for point in points])
    mean = float(outcomes.mean())
    if len(outcomes) == 1:
        return Estimate(mean, *wilson(mean * outcomes.size, outcomes.size))
    low, high = bootstrap(outcomes)
    return Estimate(mean, max(0.0, low), high)


def estimate_gain(points: Sequence[Point], baseline: Sequence[Point], name: str) -> Estimate:
    """Return a mean difference of accuracies of the same seeds, on the same images."""
    by_seed = {point.seed: point for point in baseline}
    rows = []
    for point in points:
        if point.seed in by_seed:
            rows.append(point.outcomes[name] - by_seed[point.seed].outcomes[name])
    differences = np.stack(rows)
    return Estimate(float(differences.mean()), *bootstrap(differences))


def estimate_cost(values: Sequence[float]) -> Estimate:
    """Return a mean cost with Student's interval over seeds; for a single seed it has no width."""
    if len(values) == 1:
        return Estimate(values[0], values[0], values[0])
    low, high = t_interval(values)
    return Estimate(fmean(values), max(0.0, low), high)


def pareto(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Return which (cost, gain) no other beats, better in one of both and no worse in the other."""
    on_front = []
    for cost, gain in points:
        is_beaten = False
        for other_cost, other_gain in points:
            other_is_better = other_cost < cost or other_gain > gain
            other_is_no_worse = other_cost <= cost and other_gain >= gain
            is_beaten = is_beaten or (other_is_no_worse and other_is_better)
        on_front.append(not is_beaten)
    return on_front


def summarise(points: Sequence[Point]) -> list[RecipeSummary]:
    """Return the recipes, cheapest first.

    Raises:
        ValueError: as `mean_plain_seconds`.
    """
    by_recipe: dict[str, list[Point]] = {}
    for point in points:
        by_recipe.setdefault(point.recipe, []).append(point)
    unit = mean_plain_seconds(points)
    rates: dict[str, dict[str, Estimate]] = {}
    costs: dict[str, Estimate] = {}
    for name, seeds in by_recipe.items():
        rates[name] = {key: estimate_rate(seeds, key) for key in RATES}
        costs[name] = estimate_cost([point.total_seconds / unit for point in seeds])
    places = [(costs[name].value, rates[name]["worst_4"].value) for name in by_recipe]
    summaries = []
    for (name, seeds), front in zip(by_recipe.items(), pareto(places), strict=True):
        means = {key: fmean(getattr(point, key) for point in seeds) for key in COSTS}
        summary = RecipeSummary(
            name,
            seeds=tuple(sorted(point.seed for point in seeds)),
            rates=rates[name],
            gains=estimate_gains(seeds, by_recipe),
            relative=costs[name],
            collapsed=sum(point.collapsed for point in seeds),
            front=front,
            **means,
        )
        summaries.append(summary)
    return sorted(summaries, key=lambda summary: (summary.relative.value, summary.name))


def estimate_gains(
    points: Sequence[Point], by_recipe: dict[str, list[Point]]
) -> dict[str, Estimate]:
    """Return the gains over plain training; empty where none of its runs has the same seeds."""
    baseline = by_recipe.get(points[0].baseline or "", [])
    baseline_seeds = {point.seed for point in baseline}
    if not any(point.seed in baseline_seeds for point in points):
        return {}
    return {key: estimate_gain(points, baseline, key) for key in RATES}


def mean_plain_seconds(points: Sequence[Point]) -> float:
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
