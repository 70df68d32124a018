"""Recipes summarised over their seeds: means, intervals, and who is on the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import NamedTuple

from moireaug.evaluation.statistics import t_interval, wilson
from training.points import Point

RATES = {
    "clean": "clean",
    "natural": "natural moiré",
    "unseen_mean": "unseen scenes, mean",
    "unseen_worst": "unseen scenes, worst",
    "worst_4": "worst case 4/255",
    "worst_8": "worst case 8/255",
    "pgd_4": "PGD 4/255, no camera",
}


class Estimate(NamedTuple):
    """A mean over seeds and its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Recipe:
    """All seeds of one recipe.

    Args:
        rates: the keys of `RATES` to accuracies in [0, 1].
        seconds, start_seconds, passes, images_per_second: means over seeds, as `Point` has them.
        relative: training with its start, over the mean of recipe `clean`.
        collapsed: number of seeds whose training collapsed.
        front: no other recipe is as robust at 4/255 in less time, or more robust in the same.
    """

    name: str
    seeds: tuple[int, ...]
    rates: dict[str, Estimate]
    seconds: float
    start_seconds: float
    relative: Estimate
    passes: float
    images_per_second: float
    collapsed: int
    front: bool


def rate(values: Sequence[float], n: int) -> Estimate:
    """An accuracy: by Student's t over seeds; of one seed, what its n images can tell (Wilson)."""
    mean = fmean(values)
    low, high = t_interval(values) if len(values) > 1 else wilson(mean * n, n)
    return Estimate(mean, max(0.0, low), min(1.0, high))


def ratio(values: Sequence[float]) -> Estimate:
    """A cost: by Student's t over seeds; one seed's says nothing of its scatter."""
    low, high = t_interval(values) if len(values) > 1 else (values[0], values[0])
    return Estimate(fmean(values), max(0.0, low), high)


def pareto(points: Sequence[tuple[float, float]]) -> list[bool]:
    """Which of (cost, gain) no other beats: in one of both, without being worse in the other."""
    return [not any(c <= cost and g >= gain and (c, g) != (cost, gain) for c, g in points) for cost, gain in points]


def summarise(points: Sequence[Point]) -> list[Recipe]:
    """The recipes, cheapest first."""
    by_name: dict[str, list[Point]] = {}
    for p in points:
        by_name.setdefault(p.recipe, []).append(p)
    own_last = sorted(points, key=lambda p: p.recipe == "clean")  # what clean says of itself goes before a copy
    unit = fmean({p.seed: p.clean_seconds for p in own_last}.values())
    costs = {name: ratio([p.total_seconds / unit for p in own]) for name, own in by_name.items()}
    rates = {
        name: {key: rate([getattr(p, key) for p in own], own[0].n) for key in RATES} for name, own in by_name.items()
    }
    fronts = pareto([(costs[name].value, rates[name]["worst_4"].value) for name in by_name])
    found = []
    for (name, own), front in zip(by_name.items(), fronts, strict=True):
        means = {key: fmean(getattr(p, key) for p in own) for key in
                 ("seconds", "start_seconds", "passes", "images_per_second")}  # fmt: skip
        seeds, collapsed = tuple(sorted(p.seed for p in own)), sum(p.collapsed for p in own)
        found.append(Recipe(name, seeds, rates[name], relative=costs[name], collapsed=collapsed, front=front, **means))
    return sorted(found, key=lambda r: (r.relative.value, r.name))
