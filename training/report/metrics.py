"""The metrics of a run, read: any entry may be missing, and None and NaN stand for unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from training.report.numbers import finite

Metrics = Mapping[str, Any]


@dataclass(frozen=True)
class Rate:
    """A rate and its 95 % interval; None where it is not known."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


def name_of(side: Metrics) -> str:
    """Return the name of a model: its recipe, or its architecture where it was not trained
    here."""
    recipe = side.get("recipe")
    if recipe and recipe != "pretrained":
        return str(recipe)
    return str(side.get("model") or "this model")


def total_seconds(side: Metrics | None) -> float | None:
    """Return the seconds that training took, including those of the weights that it started
    from."""
    train = (side or {}).get("train") or {}
    total = finite(train.get("total_seconds"))
    return finite(train.get("seconds")) if total is None else total


def is_attack(line: Metrics) -> bool:
    """Return whether an attacker searches for this row's noise; the others show the camera
    alone."""
    control = line.get("control")
    return not control if control is not None else str(line["name"]).startswith(("ma_", "pgd"))


def row_of(side: Metrics | None, name: str) -> Metrics:
    """Return a model's row of that name; empty where it has none."""
    for row in (side or {}).get("reattack") or []:
        if row["name"] == name:
            return row
    return {}


def rate_of(row: Metrics, key: str) -> Rate:
    """Return a row's "accuracy" or "success", and its interval."""
    ends = row.get(f"{key}_interval") or (None, None)
    return Rate(finite(row.get(key)), *_interval(ends))


def _interval(ends: Sequence[Any]) -> tuple[float | None, float | None]:
    """Return the two ends of an interval; None where they are not finite."""
    low, high = (finite(end) for end in ends)
    return (None, None) if low is None or high is None else (low, high)


def gain_of(metrics: Metrics, name: str) -> Rate:
    """Return the accuracy of this model minus the baseline's in one row, and its interval."""
    value = finite((metrics.get("gain") or {}).get(name))
    ends = (metrics.get("gain_interval") or {}).get(name) or (None, None)
    return Rate(value, *_interval(ends))
