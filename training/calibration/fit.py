"""Search the ranges of a scene so that its photos have the statistics of real ones.

The search is CMA-ES (Hansen and Ostermeier, 2001) from the package `cma`: it takes a few hundred
evaluations for a few dozen numbers that depend on one another, where differential evolution needs
thousands, and copes with the steps in the distance. Every evaluation draws the same shots (common
random numbers), so that the distance is a function of the ranges alone. A search fits those shots
too: whether the scene has become better is judged on others. The pictures are not held out: the
crops that judge are all, with the at most 24 that the search looked at.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from moireaug import Scene
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds
from training.calibration.compare import (
    Crops,
    Rows,
    compare_statistics,
    mean_distance,
    measure_crops,
    photograph_crops,
)

# share of a field's limits: a range without width draws no number, and shifts others' draws
MIN_WIDTH = 1e-6
MAX_CROPS = 24  # of an evaluation
INITIAL_STEP = 0.15  # of the search, as a share of each field's limits
REFUSED_DISTANCE = 10.0  # of ranges that no scene can have


class SearchedField(NamedTuple):
    """A ranged field of a scene, "part.field", and the limits of its search."""

    field: str
    low: float
    high: float


# A new field takes one line. A scene whose own range is wider widens these limits. JPEG quality is
# not searched: 0 is no JPEG and 1 the worst one, a jump that no search crosses.
CAMERA_FIELDS = (
    SearchedField("panel.lit", 0.3, 1.0),
    SearchedField("panel.black", 0.0, 0.05),
    SearchedField("panel.glare", 0.0, 0.2),
    SearchedField("view.roll", -20.0, 20.0),
    SearchedField("lens.blur", 0.2, 2.0),
    SearchedField("lens.motion_x", -2.0, 2.0),
    SearchedField("sensor.gain", 1.0, 6.0),
    SearchedField("sensor.read_noise", 0.0, 0.03),
    SearchedField("sensor.crosstalk", 0.0, 0.3),
    SearchedField("develop.red", 0.7, 1.4),
    SearchedField("develop.blue", 0.7, 1.4),
    SearchedField("develop.saturation", 0.3, 1.6),
    SearchedField("develop.shoulder", 0.0, 3.0),
    SearchedField("develop.contrast", -0.5, 1.0),
    SearchedField("develop.brighten", -0.1, 0.2),
    SearchedField("develop.chroma_blur", 0.0, 3.0),
    SearchedField("develop.sharpen", 0.0, 2.0),
)
# of a screen, where a scene states them; else the scale is searched
SCREEN_FIELDS = (
    SearchedField("panel.width", 64.0, 2500.0),
    SearchedField("sensor.pitch", 1.0, 3.5),
    SearchedField("sensor.shrink", 1.0, 4.0),
)
SCALE_FIELD = SearchedField("panel.scale", 0.4, 2.0)


def fields_to_search(scene: Scene) -> tuple[SearchedField, ...]:
    """Return the fields of a scene to search. Width, pitch and shrink are ranges in a binned
    reading alone, which has no scale where it states two of them."""
    fields = [one for one in SCREEN_FIELDS if scene.is_binned and range_of(scene, one.field)[1]]
    if not range_of(scene, "panel.width")[1] and not scene.is_crop:
        fields.append(SCALE_FIELD)
    return (*fields, *CAMERA_FIELDS)


def range_of(scene: Scene, field: str) -> tuple[float, float]:
    """Return the range of a field, "part.field"."""
    part, name = field.split(".")
    return bounds(getattr(getattr(scene, part), name))


def widen(scene: Scene, field: SearchedField) -> SearchedField:
    """Return a field with limits that include a scene's own range of it."""
    low, high = range_of(scene, field.field)
    return SearchedField(field.field, min(low, field.low), max(high, field.high))


def encode(scene: Scene, limits: Sequence[SearchedField]) -> NDArray[np.float64]:
    """Return the ranges of F fields as 2 F numbers in [0, 1]: the low end and the width of each."""
    numbers = []
    for field, low, high in limits:
        begin, end = range_of(scene, field)
        numbers += [(begin - low) / (high - low), (end - begin) / (high - low)]
    return np.clip(numbers, 0.01, 0.99)


def decode(
    scene: Scene, limits: Sequence[SearchedField], point: NDArray[np.float64]
) -> Scene | None:
    """Return the scene that these numbers encode; None if no scene can have its ranges."""
    ranges = {}
    for (field, low, high), (begin, width) in zip(limits, point.reshape(-1, 2), strict=True):
        first = low + (high - low) * min(float(begin), 1 - MIN_WIDTH)
        last = min(high, first + (high - low) * max(float(width), MIN_WIDTH))
        ranges[field] = (first, last)
    try:
        decoded = with_values(scene, ranges)
        decoded.plan()
    except ValueError:
        return None
    return decoded


def round_ranges(scene: Scene, limits: Sequence[SearchedField]) -> Scene:
    """Return a scene with its searched ranges rounded to four digits; a range that would lose its
    width, and with it its draws, stays."""
    ranges = {}
    for field, _, _ in limits:
        first, last = range_of(scene, field)
        low, high = float(f"{first:.4g}"), float(f"{last:.4g}")
        if low < high:
            ranges[field] = low, high
    return with_values(scene, ranges)


@dataclass(frozen=True)
class FittedScene:
    """The best scene of a search, and the cost of that.

    Args:
        before, after: mean distances of both, see `compare.mean_distance`, on all crops, in shots
            that the search did not see.
        searched_before, searched_after: mean distances on the crops and shots of the search.
    """

    scene: Scene
    start: Scene
    before: float
    after: float
    searched_before: float
    searched_after: float
    evaluations: int
    seconds: float
    searched: tuple[SearchedField, ...]

    def range_rows(self) -> list[dict[str, str]]:
        """Return a row of the report for each field that was searched."""
        rows = []
        for field, low, high in self.searched:
            before, after = (range_of(scene, field) for scene in (self.start, self.scene))
            texts = {"before": _range_text(before), "after": _range_text(after)}
            rows.append({"field": field, "within": f"{low:g} to {high:g}", **texts})
        return rows

    def sentence(self) -> str:
        """Return the result as a sentence."""
        cost = f"{self.evaluations} evaluations in {self.seconds:.0f} s"
        if self.scene is self.start:
            return f"{cost} found no better ranges: the scene stays as it was."
        return (
            f"{cost} brought the mean distance from {self.before:.3f} to {self.after:.3f}; on the "
            f"shots that the search looked at, from {self.searched_before:.3f} to "
            f"{self.searched_after:.3f}."
        )


def fit(
    start: Scene, crops: Crops, real: Rows, evaluations: int, seconds: float, seed: int
) -> FittedScene:
    """Search the ranges of a scene, from its own on; Ctrl-C ends the search, and the best so far is
    judged.

    Args:
        start: scene to begin with; its other fields stay as they are.
        seconds: time of the search, which ends with the generation that reaches it.
        seed: seed of the shots that judge. The search and its shots have the next one.

    Returns:
        The best scene of the search, or `start` where that is no better in other shots.
    """
    import cma  # takes seconds to import

    start_time = time.perf_counter()
    spread = np.linspace(0, len(real) - 1, min(MAX_CROPS, len(real)))
    rows = np.unique(spread.round().astype(int))
    if crops.originals is None:
        raise ValueError("a fit needs the pictures that were on the screen; got photos alone.")
    originals = crops.originals[torch.from_numpy(rows)]
    statistics = [real[row] for row in rows]

    limits = tuple(widen(start, field) for field in fields_to_search(start))
    first = distance_to(start, originals, statistics, seed + 1)
    best, best_distance, count = start, first, 1
    print(f"fit: distance {first:.3f} at the start")
    options = {"bounds": [0, 1], "seed": seed + 1, "verbose": -9}
    search = cma.CMAEvolutionStrategy(encode(start, limits), INITIAL_STEP, options)
    try:
        end_time = start_time + seconds
        while count < evaluations and time.perf_counter() < end_time and not search.stop():
            points = search.ask()
            values = []
            for point in points[: evaluations - count]:
                scene = decode(start, limits, point)
                value = REFUSED_DISTANCE
                if scene is not None:
                    value = distance_to(scene, originals, statistics, seed + 1)
                if scene is not None and value < best_distance:
                    best, best_distance = scene, value
                values.append(value)
                count += 1
            print(f"fit: distance {best_distance:.3f} after {count} evaluations")
            if len(values) == len(points):
                search.tell(points, values)
    except KeyboardInterrupt:
        print(f"fit: interrupted after {count} evaluations; the best so far is kept")
    if best is not start:
        best = round_ranges(best, limits)
    before, after = (distance_to(scene, crops.originals, real, seed) for scene in (start, best))
    if after >= before:
        best, after = start, before
    return FittedScene(
        scene=best,
        start=start,
        before=before,
        after=after,
        searched_before=first,
        searched_after=distance_to(best, originals, statistics, seed + 1),
        evaluations=count,
        seconds=time.perf_counter() - start_time,
        searched=limits,
    )


def distance_to(scene: Scene, originals: Tensor, real: Rows, seed: int) -> float:
    """Return the mean distance of a scene's photos of crops from the statistics of the real
    ones."""
    photos = photograph_crops(scene, originals, seed)
    return mean_distance(compare_statistics(real, measure_crops(photos, originals)))


def _range_text(values: tuple[float, float]) -> str:
    low, high = values
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
