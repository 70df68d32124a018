"""Costs of a run's training: each a column of frontier.csv and, if it has a title, of the table."""

from collections.abc import Callable
from typing import NamedTuple

from training.runs.metrics import PlainMetrics, RunMetrics, TrainCost


class Cost(NamedTuple):
    """A cost of a run, None where it is not known; its title in the table and its decimals."""

    of_run: Callable[[RunMetrics], float | None]
    title: str | None = None
    digits: int = 1


def own_cost(metrics: RunMetrics | PlainMetrics | None) -> TrainCost:
    """Return the cost of a training, without that of its first weights."""
    if metrics is None or metrics.train is None:
        raise KeyError("start" if metrics is None else "train")
    return metrics.train


def own_seconds(metrics: RunMetrics) -> float:
    """Return the time of a run's own training, by its median epoch."""
    return own_cost(metrics).steady_seconds


def start_seconds(metrics: RunMetrics) -> float:
    """Return the time of the training of a run's first weights, 0 for random ones."""
    return _start_seconds(own_cost(metrics), metrics)


def total_seconds(metrics: RunMetrics) -> float:
    """Return the time of both."""
    return own_seconds(metrics) + start_seconds(metrics)


def plain_seconds(metrics: RunMetrics) -> float | None:
    """Return the time of plain training with the same seed and settings, its start included."""
    plain = metrics if metrics.recipe == "baseline" else metrics.baseline
    if plain is None:
        return None
    cost = own_cost(plain)
    return cost.steady_seconds + _start_seconds(cost, metrics)


def passes(metrics: RunMetrics) -> float:
    """Return the passes forward and backward per image of a run's own training."""
    return own_cost(metrics).passes


def images_per_second(metrics: RunMetrics) -> float:
    """Return the images per second of a run's own training, by its median epoch."""
    train = own_cost(metrics)
    return train.images_per_second * train.seconds / train.steady_seconds


def _start_seconds(train: TrainCost, metrics: RunMetrics) -> float:
    """Return the time of the training of the weights that a run, or its baseline, began with."""
    return own_cost(metrics.start).steady_seconds if train.init == "clean" else 0.0


COSTS = {
    "seconds": Cost(own_seconds, "training, s"),
    "start_seconds": Cost(start_seconds, "its start, s"),
    "total_seconds": Cost(total_seconds),
    "plain_seconds": Cost(plain_seconds),
    "passes": Cost(passes, "passes", digits=2),
    "images_per_second": Cost(images_per_second, "images/s", digits=0),
}
TABLE_COSTS = {name: cost for name, cost in COSTS.items() if cost.title}
