"""The rows of the table of speed and memory, and the sizes that they are measured on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch

from benchmarks.measure import Timing, text_of_rows


@dataclass(frozen=True)
class Size:
    """What the rows are measured on."""

    side: int = 224
    batch: int = 16
    paper: int = 299  # px of the paper's images
    large: tuple[int, int] = (3000, 4000)  # 12 megapixels
    training: tuple[int, int] = (128, 48)  # batch and px of a training step
    lit: tuple[float, ...] = (0.35, 0.6, 0.9)  # of a panel with a black matrix
    layer: tuple[int, ...] = (128, 256, 400)  # px of images through the layer
    repeats: int = 15
    slow: int = 5  # repeats of what takes seconds
    first: int = 3  # of first calls ever, 10 to 20 s each
    calls: int = 200  # of a transform that chooses images at random
    threads: int = 2

    def images(self) -> torch.Tensor:
        return torch.rand(
            self.batch, 3, self.side, self.side, generator=torch.Generator().manual_seed(0)
        )


@dataclass(frozen=True)
class Row:
    """One line: ours, in its unit with its quartiles, and what it is compared with. Less is
    better."""

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


def time_row(
    what: str, time: Timing, against: str = "", other: Timing | None = None, **bars: float
) -> Row:
    """Return a row of a time, compared with another."""
    ms = [1e3 * s for s in (time.median, time.low, time.high)]
    return Row(what, *ms, "ms", against, 1e3 * other.median if other else None, **bars)


def report(rows: Sequence[Row]) -> str:
    lines = []
    for row in rows:
        line = row.to_dict()
        if row.met and row.stretch is not None and row.ratio <= row.stretch:
            line["met"] = "yes, and the stretch"
        lines.append(line)
    return text_of_rows(lines)
