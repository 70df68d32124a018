"""Crops of real photos and of a scene's photos of the same originals; their statistics compared."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np
import torch
from torch import Tensor

from moireaug import Scene, capture
from training.data.codes import rounded
from training.data.real_pairs import ScreenPhoto
from training.photographs.statistics import STATISTICS, Statistic, compare, measure, percentiles
from training.report.terminal import aligned

Rows = Sequence[Mapping[str, float]]
Span = tuple[float, float, float]

BATCH_CROPS = 16  # that are measured at a time
PHOTO_BATCH_CROPS = 8  # that are photographed at a time


@dataclass(frozen=True)
class StatisticRow:
    """One statistic of real and simulated photos.

    Args:
        name: key of `STATISTICS`.
        real, simulated: 10th percentile, median, 90th percentile over the crops; None where there
            is no simulated photo.
        distance: distance between the two, see `mean_distance`; None where it is not compared.
    """

    name: str
    real: Span
    simulated: Span | None = None
    distance: float | None = None

    @property
    def statistic(self) -> Statistic:
        return STATISTICS[self.name]

    def to_dict(self) -> dict[str, float | str | None]:
        """Return a row of statistics.csv."""
        row: dict[str, float | str | None] = {"name": self.name, "unit": self.statistic.unit}
        for kind, values in (("real", self.real), ("simulated", self.simulated)):
            for end, value in zip(("10", "50", "90"), values or (None,) * 3, strict=True):
                row[f"{kind}_{end}"] = value
        return row | {"distance": self.distance}


def measure_crops(photos: Tensor, originals: Tensor | None) -> list[dict[str, float]]:
    """Return the statistics of each crop; `photos` and `originals` are (N, 3, S, S) uint8."""
    rows: list[dict[str, float]] = []
    for start in range(0, len(photos), BATCH_CROPS):
        batch = slice(start, start + BATCH_CROPS)
        on_screen = None if originals is None else originals[batch].float() / 255
        rows += measure(photos[batch].float() / 255, on_screen)
    return rows


def compare_statistics(real: Rows, simulated: Rows | None) -> list[StatisticRow]:
    """Return a row for every statistic of the real photos."""
    table = []
    for name in real[0]:
        ours, theirs, distance = percentiles([row[name] for row in real]), None, None
        if simulated is not None:
            theirs = percentiles([row[name] for row in simulated])
            if STATISTICS[name].compared:
                distance = fmean(
                    abs(compare(*ends, STATISTICS[name])) for ends in zip(ours, theirs, strict=True)
                )
        table.append(StatisticRow(name, ours, theirs, distance))
    return table


def mean_distance(table: Sequence[StatisticRow]) -> float:
    """Return the distance of a scene from reality: the mean absolute logarithm of the ratios of the
    10th percentiles, medians and 90th percentiles of all compared statistics.

    0.7 is a factor of two. Values near zero count by their difference, see
    `training.photographs.statistics.compare`."""
    return fmean(row.distance for row in table if row.distance is not None)


def terminal_parts(table: Sequence[StatisticRow], name: str) -> list[str]:
    """Return the table for the terminal."""
    with_scene = table[0].simulated is not None
    heads = ["median (10 to 90 %)", "unit", "real"]
    if with_scene:
        heads += [name, "apart"]
    rows = [heads]
    for statistic_row in table:
        statistic, distance = statistic_row.statistic, statistic_row.distance
        cells = [statistic.title, statistic.unit, span_text(statistic_row.real)]
        if with_scene:
            cells.append(span_text(statistic_row.simulated))
            cells.append("" if distance is None else f"{distance:.2f}")
        rows.append(cells)
    parts = [aligned(rows)]
    if with_scene:
        parts.append(f"Mean distance: {mean_distance(table):.3f} (0.7 is a factor of two)")
    return parts


def span_text(values: Span | None) -> str:
    """Return a median with its percentiles."""
    if values is None:
        return ""
    low, median, high = (number_text(value) for value in values)
    return f"{median} ({low} to {high})"


def number_text(value: float) -> str:
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


@dataclass(frozen=True, eq=False)
class Crops:
    """Crops at the same places of photos and originals.

    Args:
        photos: (N, 3, S, S) uint8.
        originals: (N, 3, S, S) uint8 of the originals; None where only photos are known.
        picture: (N,) int64 index of each crop's picture.
    """

    photos: Tensor
    originals: Tensor | None
    picture: Tensor
    names: tuple[str, ...]


def cut_crops(pictures: Iterable[ScreenPhoto], side: int, each: int, seed: int = 0) -> Crops:
    """Cut `each` square crops of `side` pixels out of every picture, at random places.

    Args:
        pictures: photos, all of them with originals, or none.
    """
    draw = np.random.default_rng(seed)
    photos: list[Tensor] = []
    originals: list[Tensor] = []
    index: list[int] = []
    names: list[str] = []
    for name, photo, original in pictures:
        height, width = photo.shape[-2:]
        if min(height, width) < side:
            raise ValueError(
                f"{name} is {width} x {height} pixels, smaller than a crop of {side}: pass "
                "a smaller size=N."
            )
        for _ in range(each):
            y = int(draw.integers(0, height - side + 1))
            x = int(draw.integers(0, width - side + 1))
            # a view would keep the whole photo
            photos.append(photo[:, y : y + side, x : x + side].clone())
            index.append(len(names))
            if original is not None:
                originals.append(original[:, y : y + side, x : x + side].clone())
        names.append(name)
    both = torch.stack(originals) if originals else None
    return Crops(torch.stack(photos), both, torch.tensor(index, device="cpu"), tuple(names))


@torch.no_grad()
def photograph_crops(scene: Scene, originals: Tensor, seed: int = 0) -> Tensor:
    """Photograph crops (N, 3, S, S) uint8 in a scene; return the photos as 8-bit codes of the same
    shape, as files hold them."""
    generator = torch.Generator().manual_seed(seed)
    height, width = originals.shape[-2:]
    shot = scene.sample(len(originals), (height, width), generator)
    photos = []
    for start in range(0, len(originals), PHOTO_BATCH_CROPS):
        rows = slice(start, start + PHOTO_BATCH_CROPS)
        photos.append(capture(originals[rows].float() / 255, shot[rows]))
    return rounded(torch.cat(photos))
