"""The rows of the table of speed and memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.measure import Timing, show, table


@dataclass(frozen=True)
class Row:
    """One line: ours, in its unit with its quartiles, and what it is compared with."""

    what: str
    value: float
    low: float
    high: float
    unit: str
    against: str = ""
    other: float | None = None
    bar: float | None = None
    stretch: float | None = None

    @property
    def ratio(self) -> float | None:
        return self.value / self.other if self.other else None

    @property
    def met(self) -> bool | None:
        return None if self.bar is None or self.ratio is None else self.ratio <= self.bar

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"ratio": self.ratio, "met": self.met}


def in_ms(what: str, time: Timing, against: str = "", other: Timing | None = None, **bars: float) -> Row:
    """A row of a time, set against another."""
    ms = [1e3 * s for s in (time.median, time.low, time.high)]
    return Row(what, *ms, "ms", against, 1e3 * other.median if other else None, **bars)


def report(rows: Sequence[Row]) -> str:
    lines = []
    for row in rows:
        quartiles = f"{show(row.low)} to {show(row.high)}"
        lines.append((row.what, row.value, quartiles, row.unit, row.against, row.other, row.ratio, row.bar, row.stretch,
                      row.met))  # fmt: skip
    columns = ("what", "value", "quartiles", "unit", "against", "its value", "ratio", "bar", "stretch", "met")
    return table(columns, lines)
