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


def start_seconds(train: TrainCost, metrics: RunMetrics) -> float:
    """Return the time of the training of the weights that a run, or its baseline, began with, 0 for
    random ones."""
    return own_cost(metrics.start).steady_seconds if train.init == "clean" else 0.0


def total_seconds(train: TrainCost, metrics: RunMetrics) -> float:
    """Return the time of a training and of that of its first weights, by the median epoch."""
    return train.steady_seconds + start_seconds(train, metrics)


def plain_seconds(metrics: RunMetrics) -> float | None:
    """Return the time of plain training with the same seed and settings, its start included; None
    where it is not known, or what a run is compared with was not trained."""
    plain = metrics if metrics.recipe == "baseline" else metrics.baseline
    return total_seconds(plain.train, metrics) if plain and plain.train else None


def images_per_second(metrics: RunMetrics) -> float:
    """Return the images per second of a run's own training, by its median epoch."""
    train = own_cost(metrics)
    return train.images_per_second * train.seconds / train.steady_seconds


COSTS = {
    "seconds": Cost(lambda run: own_cost(run).steady_seconds, "training, s"),
    "start_seconds": Cost(lambda run: start_seconds(own_cost(run), run), "its start, s"),
    "total_seconds": Cost(lambda run: total_seconds(own_cost(run), run)),
    "plain_seconds": Cost(plain_seconds),
    "passes": Cost(lambda run: own_cost(run).passes, "passes", digits=2),
    "images_per_second": Cost(images_per_second, "images/s", digits=0),
}
TABLE_COSTS = {name: cost for name, cost in COSTS.items() if cost.title}
