"""Search the ranges of a scene so that its photos have the statistics of real ones.

The search is CMA-ES (Hansen and Ostermeier, 2001) from the package `cma`: it takes a few hundred
evaluations for a few dozen numbers that depend on one another, where differential evolution needs
thousands, and copes with the steps in the distance. Every evaluation draws the same shots (common
random numbers), so that the distance is a function of the ranges alone. A search fits those shots
too: whether the scene has become better is judged on others.
"""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moireaug import Scene
from training.calibration.compare import (
    Crops,
    Rows,
    compare_statistics,
    mean_distance,
    measure_crops,
    photograph_crops,
)
from training.calibration.ranges import (
    SearchedField,
    decode,
    encode,
    fields_to_search,
    range_of,
    rounded,
    widen,
)

MAX_CROPS = 24  # of an evaluation
INITIAL_STEP = 0.15  # of the search, as a share of each field's limits
REFUSED_DISTANCE = 10.0  # of ranges that no scene can have


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

    def report_values(self) -> dict[str, Any]:
        """Return the values of the report: a sentence, and a row for each field."""
        rows = []
        for field, low, high in self.searched:
            rows.append(
                {
                    "field": field,
                    "before": _range_text(range_of(self.start, field)),
                    "after": _range_text(range_of(self.scene, field)),
                    "within": f"{low:g} to {high:g}",
                }
            )
        return {"lead": self.sentence(), "rows": rows}

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
        best = rounded(best, limits)
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
