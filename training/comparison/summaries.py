"""Recipes summarised over their seeds: means, confidence intervals and the Pareto front."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean, stdev
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from moireaug.common.argument_checks import one_of
from moireaug.evaluation.statistics import Z95, wilson
from training.comparison.frame import RATES

COSTS = ["seconds", "start_seconds", "passes", "images_per_second"]
ROUNDING_ERROR = 1e-12  # of equal outcomes


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
    """Return a mean accuracy with an interval over seeds and images; for a single seed, over its
    images alone (Wilson).

    Args:
        correct: (seeds,) of (n,) whether each image is right.
    """
    values = np.stack(correct.tolist())
    mean = float(values.mean())
    if len(values) == 1:
        return Estimate(mean, *wilson(mean * values.size, values.size))
    low, high = bootstrap(values)
    return Estimate(mean, max(0.0, low), min(1.0, high))


def estimate_gains(seeds: pd.DataFrame, rivals: pd.DataFrame) -> dict[str, Estimate]:
    """Return the mean differences to another recipe of the same seeds, on the same images; empty
    where none of its runs has the same seeds, or a single number says nothing of an interval."""
    pairs = seeds.merge(rivals, on="seed", suffixes=("", "_rival"))
    gains: dict[str, Estimate] = {}
    for rate in RATES if len(pairs) else ():
        differences = np.stack((pairs[rate] - pairs[f"{rate}_rival"]).tolist())
        if differences.size < 2:
            return {}
        gains[rate] = Estimate(float(differences.mean()), *bootstrap(differences))
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


def t_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of the mean of two or more measurements, such as seeds (Student,
    1908)."""
    half = float(stdtrit(len(values) - 1, 0.975)) * stdev(values) / math.sqrt(len(values))
    return fmean(values) - half, fmean(values) + half


def bootstrap(values: np.ndarray, draws: int = 4000) -> tuple[float, float]:
    """Return the 95 % interval of a mean over seeds and images, for the choice of both.

    Args:
        values: (seeds, images), numbers in [-1, 1], the same images in every row.

    Seeds and images are drawn again with replacement, independently (Owen's pigeonhole bootstrap,
    2007), by a generator of fixed seed. Few seeds scatter less when resampled than in truth: their
    part is widened by sqrt(S / (S - 1)), and by as much as Student's t is wider than a normal
    distribution. On simulated tables of three seeds and 200 images, 97 to 100 % of these intervals
    hold the truth, and 86 to 95 % of those by Student's t over the seeds alone. Where all outcomes
    are the same, the interval is as wide as Wilson's of no hit among so many images.
    """
    seeds, images = values.shape
    mean = float(values.mean())
    if np.ptp(values) < ROUNDING_ERROR:
        _, width = wilson(0, images)
        low, high = mean - width, mean + width
        return max(-1.0, low), min(1.0, high)
    image_shares, seed_rows = _resample(seeds, images, draws)
    rows = image_shares @ values.T  # (draws, seeds): each seed's mean on the drawn images
    centre = rows.mean(1, keepdims=True)
    widening = 1.0
    if seeds > 1:
        student = float(stdtrit(seeds - 1, 0.975)) / Z95
        widening = student * math.sqrt(seeds / (seeds - 1))
    means = np.take_along_axis(rows - centre, seed_rows, 1).mean(1) * widening + centre[:, 0]
    low, high = np.quantile(means, [0.025, 0.975])
    return max(-1.0, float(low)), min(1.0, float(high))


@functools.lru_cache(maxsize=1)  # a table has many figures of one shape, and drawing takes longest
def _resample(seeds: int, images: int, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each image in each draw (draws, images), and the drawn seeds (draws,
    seeds)."""
    rng = np.random.default_rng(0)
    image_shares = rng.multinomial(images, np.full(images, 1 / images), draws) / images
    return image_shares, rng.integers(0, seeds, (draws, seeds))
