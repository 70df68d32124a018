"""Recipes summarised over their seeds: means, intervals and the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

import numpy as np
import pandas as pd

from moireaug.evaluation.statistics import wilson
from training.comparison.frame import RATES
from training.comparison.statistics import bootstrap, t_interval

COSTS = ["seconds", "start_seconds", "passes", "images_per_second"]


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
        seconds, start_seconds, passes, images_per_second: means over seeds of the columns of
            `RunTable`.
        relative_time: mean of `relative_times`.
        collapsed_count: number of seeds whose training collapsed.
        is_on_front: whether no other recipe is as robust at 4/255 in less time, or more robust in
            the same.
    """

    name: str
    seeds: tuple[int, ...]
    rates: dict[str, Estimate]
    gains: dict[str, Estimate]
    seconds: float
    start_seconds: float
    passes: float
    images_per_second: float
    relative_time: Estimate
    collapsed_count: int
    is_on_front: bool = False


def summarise(runs: pd.DataFrame) -> list[RecipeSummary]:
    """Return the recipes, cheapest first.

    Args:
        runs: runs, as in `RunTable`.

    Raises:
        ValueError: as `relative_times`.
    """
    runs = runs.assign(relative_time=relative_times(runs))
    baseline = runs[runs["recipe"] == "baseline"]
    summaries, places = [], []
    for name, seeds in runs.groupby("recipe", sort=False):
        summary = RecipeSummary(
            name,
            seeds=tuple(sorted(seeds["seed"])),
            rates={rate: estimate_rate(seeds[rate]) for rate in RATES},
            gains=estimate_gains(seeds, baseline) if seeds["baseline"].notna().all() else {},
            relative_time=estimate_cost(seeds["relative_time"].tolist()),
            collapsed_count=int(seeds["collapsed"].sum()),
            **seeds[COSTS].mean(),
        )
        summaries.append(summary)
        places.append((summary.relative_time.value, summary.rates["worst_4"].value))
    fronts = pareto(places)
    summaries = [
        replace(one, is_on_front=is_on_front)
        for one, is_on_front in zip(summaries, fronts, strict=True)
    ]
    return sorted(summaries, key=lambda summary: (summary.relative_time.value, summary.name))


def relative_times(runs: pd.DataFrame) -> pd.Series:
    """Return the time of each run, its start included, over that of its own plain training, which
    ran on the same machine; where that is not known, over the mean.

    Raises:
        ValueError: no run says it.
    """
    plain_seconds = runs["plain_seconds"].astype(float)
    if plain_seconds.isna().all():
        raise ValueError(
            "no run says how long plain training takes, which costs are relative to: train and "
            "attack recipe baseline with the same settings."
        )
    return runs["total_seconds"] / plain_seconds.fillna(plain_seconds.mean())


def estimate_rate(outcomes: pd.Series) -> Estimate:
    """Return a mean accuracy with an interval over seeds and images; for a single seed, over its
    images alone (Wilson); of means, over seeds alone.

    Args:
        outcomes: (seeds,) of (n,) outcomes, or of their mean (1,).
    """
    values = np.stack(outcomes.tolist())
    mean = float(values.mean())
    if len(values) == 1:
        return Estimate(mean, *wilson(mean * values.size, values.size))
    low, high = _interval(values)
    return Estimate(mean, max(0.0, low), min(1.0, high))


def estimate_gains(seeds: pd.DataFrame, baseline: pd.DataFrame) -> dict[str, Estimate]:
    """Return the mean differences to plain training of the same seeds, on the same images; empty
    where none of its runs has the same seeds."""
    pairs = seeds.merge(baseline, on="seed", suffixes=("", "_plain"))
    gains = {}
    for rate in RATES if len(pairs) else ():
        differences = np.stack((pairs[rate] - pairs[f"{rate}_plain"]).tolist())
        gains[rate] = Estimate(float(differences.mean()), *_interval(differences))
    return gains


def _interval(values: np.ndarray) -> tuple[float, float]:
    """Return the interval of a mean over seeds and images, or of means (seeds, 1) over seeds."""
    return t_interval(values[:, 0].tolist()) if values.shape[1] == 1 else bootstrap(values)


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
        no_worse = [(c, g) for c, g in points if c <= cost and g >= gain]
        on_front.append(all(point == (cost, gain) for point in no_worse))
    return on_front
