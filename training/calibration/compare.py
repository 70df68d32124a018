"""Statistics of real photos beside those of a scene's photos of the same crops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from torch import Tensor

from moireaug.evaluation.report.terminal import Grid, Part
from moireaug.synthesis.statistics import STATISTICS, Statistic, compare, measure, span

Rows = Sequence[Mapping[str, float]]
Span = tuple[float, float, float]

BATCH = 16  # crops that are measured at a time


@dataclass(frozen=True)
class Line:
    """One statistic of real and simulated photos.

    Args:
        name: a key of `STATISTICS`.
        real, simulated: 10th percentile, median, 90th percentile over the crops; None where there
            is no simulated photo.
        distance: between the two, see `distance`; None where they are not compared.
    """

    name: str
    real: Span
    simulated: Span | None = None
    distance: float | None = None

    @property
    def statistic(self) -> Statistic:
        return STATISTICS[self.name]

    def to_dict(self) -> dict[str, float | str | None]:
        """Return a line of statistics.csv."""
        found: dict[str, float | str | None] = {"name": self.name, "unit": self.statistic.unit}
        for kind, values in (("real", self.real), ("simulated", self.simulated)):
            for end, value in zip(("10", "50", "90"), values or (None,) * 3, strict=True):
                found[f"{kind}_{end}"] = value
        return found | {"distance": self.distance}


def measured(photos: Tensor, originals: Tensor | None) -> list[dict[str, float]]:
    """Return the statistics of each crop; `photos` and `originals` are (N, 3, S, S) uint8."""
    rows: list[dict[str, float]] = []
    for photo, original in zip(photos.split(BATCH), _parts(originals, len(photos)), strict=True):
        rows += measure(photo.float() / 255, original)
    return rows


def _parts(originals: Tensor | None, n: int) -> list[Tensor | None]:
    if originals is None:
        return [None] * -(-n // BATCH)
    return [part.float() / 255 for part in originals.split(BATCH)]


def lines(real: Rows, simulated: Rows | None) -> list[Line]:
    """Return a line for every statistic that the real photos have."""
    found = []
    for name in real[0]:
        ours = span([row[name] for row in real])
        if simulated is None:
            found.append(Line(name, ours))
            continue
        theirs = span([row[name] for row in simulated])
        apart = None
        statistic = STATISTICS[name]
        if statistic.compared:
            distances = []
            for own, other in zip(ours, theirs, strict=True):
                distances.append(abs(compare(own, other, statistic)))
            apart = fmean(distances)
        found.append(Line(name, ours, theirs, apart))
    return found


def distance(found: Sequence[Line]) -> float:
    """Return how far a scene is from reality: the mean over all compared statistics, and their
    10th percentiles, medians and 90th percentiles, of the absolute logarithm of their ratio.

    0.7 is a factor of two. Values near zero count by their difference, see
    `moireaug.synthesis.statistics.compare`.
    """
    return fmean(line.distance for line in found if line.distance is not None)


def said(found: Sequence[Line], name: str) -> list[Part]:
    """Return the table for the terminal.

    Args:
        name: of the scene.
    """
    with_scene = found[0].simulated is not None
    heads = ["median (10 to 90 %)", "unit", "real"]
    if with_scene:
        heads += [name, "apart"]
    rows = [heads]
    for line in found:
        row = [line.statistic.title, line.statistic.unit, shown(line.real)]
        if with_scene:
            row.append(shown(line.simulated))
            row.append("" if line.distance is None else f"{line.distance:.2f}")
        rows.append(row)
    parts: list[Part] = [Grid(rows)]
    if with_scene:
        parts.append(f"Mean distance: {distance(found):.3f} (0.7 is a factor of two)")
    return parts


def shown(values: Span | None) -> str:
    """Return a median with its span."""
    if values is None:
        return ""
    low, median, high = (number(value) for value in values)
    return f"{median} ({low} to {high})"


def number(value: float) -> str:
    """Return a number with as many digits as are meaningful."""
    size = abs(value)
    if size >= 99.5:
        digits = 0
    elif size >= 9.95:
        digits = 1
    else:
        digits = 2
    rounded = f"{value:.{digits}f}"
    if float(rounded) == 0:
        return rounded.lstrip("-")
    return rounded.replace("-", "−")
