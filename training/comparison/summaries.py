"""Recipes summarised over their seeds: means, confidence intervals and the Pareto front."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

import numpy as np
import pandas as pd

from moireaug.common.argument_checks import one_of
from training.comparison.frame import RATES
from training.comparison.intervals import difference_interval, rate_interval, t_interval

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
        rates: accuracies in [0, 1], by the names of `RATES`.
        gains: their gains over another recipe with the same seeds; empty where that was not
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


def summarise(runs: pd.DataFrame, against: str = "baseline") -> list[RecipeSummary]:
    """Return the recipes, cheapest first.

    Args:
        against: recipe that gains are over. Plain training has none, nor have recipes of more
            epochs than `baseline` or another start.

    Raises:
        ValueError: another recipe than `baseline` that is not among the runs.
    """
    names = sorted({*runs["recipe"], "baseline"})
    rivals = runs[runs["recipe"] == one_of("against", against, names)]
    runs = runs.assign(relative_time=relative_times(runs))
    summaries, places = [], []
    for name, seeds in runs.groupby("recipe", sort=False):
        has_gains = seeds["baseline"].notna().all()  # plain training has no baseline, either
        summary = RecipeSummary(
            name,
            seeds=tuple(sorted(seeds["seed"])),
            rates={rate: estimate_rate(seeds[rate]) for rate in RATES},
            gains=estimate_gains(seeds, rivals) if has_gains and name != against else {},
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
    ran on the same machine; where that is not known, over the mean."""
    plain_seconds = runs["plain_seconds"].astype(float)
    if plain_seconds.isna().all():
        raise ValueError(
            "no run says how long plain training takes, which costs are relative to: train and "
            "attack recipe baseline with the same settings."
        )
    return runs["total_seconds"] / plain_seconds.fillna(plain_seconds.mean())


def estimate_rate(correct: pd.Series) -> Estimate:
    """Return a mean accuracy with its interval.

    Args:
        correct: (seeds,) of (n,) whether each image is right.
    """
    values = np.stack(correct.tolist())
    return Estimate(float(values.mean()), *rate_interval(values))


def estimate_gains(seeds: pd.DataFrame, rivals: pd.DataFrame) -> dict[str, Estimate]:
    """Return the mean differences to another recipe of the same seeds, on the same images; empty
    where none of its runs has the same seeds, or a single number says nothing of an interval."""
    pairs = seeds.merge(rivals, on="seed", suffixes=("", "_rival"))
    gains: dict[str, Estimate] = {}
    for rate in RATES if len(pairs) else ():
        differences = np.stack((pairs[rate] - pairs[f"{rate}_rival"]).tolist())
        if differences.size < 2:
            return {}
        gains[rate] = Estimate(float(differences.mean()), *difference_interval(differences))
    return gains


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
