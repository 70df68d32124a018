"""Search the ranges of a scene so that its photos have the statistics of real ones.

The search is CMA-ES (Hansen and Ostermeier, 2001) from the package `cma`: it takes a few hundred
evaluations for a few dozen numbers that depend on one another, where differential evolution needs
thousands, and copes with the steps in the distance. Every evaluation draws the same shots (common
random numbers), so that the distance is a function of the ranges alone. A search fits those shots
too: whether the scene has become better is judged on others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from moireaug import Scene
from moireaug.scene.fields import bounds
from training.calibration.compare import Rows, distance, lines, measured
from training.calibration.pairs import Crops, photographed

CROPS = 24  # that an evaluation compares
STEP = 0.15  # of the first draws, as a share of each field's limits
NARROWEST = 1e-6  # share of its limits: without width a range draws no number and shifts others'
REFUSED = 10.0  # the distance of ranges that no scene can have


class Searched(NamedTuple):
    """A ranged field of a scene, "part.field", and the limits within which it is searched."""

    field: str
    low: float
    high: float


# A new field takes one line. A scene whose own range is wider widens these limits. JPEG quality is
# not searched: 0 is no JPEG and 1 the worst one, a jump that no search crosses.
SEARCHED = (
    Searched("panel.lit", 0.3, 1.0),
    Searched("panel.black", 0.0, 0.05),
    Searched("panel.glare", 0.0, 0.2),
    Searched("view.roll", -20.0, 20.0),
    Searched("lens.blur", 0.2, 2.0),
    Searched("lens.motion_x", -2.0, 2.0),
    Searched("sensor.gain", 1.0, 6.0),
    Searched("sensor.read_noise", 0.0, 0.03),
    Searched("sensor.crosstalk", 0.0, 0.3),
    Searched("develop.red", 0.7, 1.4),
    Searched("develop.blue", 0.7, 1.4),
    Searched("develop.saturation", 0.3, 1.6),
    Searched("develop.shoulder", 0.0, 3.0),
    Searched("develop.contrast", -0.5, 1.0),
    Searched("develop.brighten", -0.1, 0.2),
    Searched("develop.chroma_blur", 0.0, 3.0),
    Searched("develop.sharpen", 0.0, 2.0),
)
# of a screen, as far as a scene states them; else the scale is searched
SCREEN = (Searched("panel.width", 64.0, 2500.0), Searched("sensor.pitch", 1.0, 3.5))
SCALE = Searched("panel.scale", 0.4, 2.0)


def searched_of(scene: Scene) -> tuple[Searched, ...]:
    """Return the fields that are searched in a scene. Width and pitch of a screen are ranges in a
    binned reading alone."""
    stated = [one for one in SCREEN if scene.is_binned and get(scene, one.field)[1]]
    if not get(scene, "panel.width")[1]:
        stated.append(SCALE)
    return (*stated, *SEARCHED)


@dataclass(frozen=True)
class Fitted:
    """The best scene that was found, and what it took.

    Args:
        start: where the search began.
        before, after: mean distances, see `compare.distance`, on all crops, in shots that the
            search did not see.
        searched_before, searched_after: on the crops and shots of the search.
        searched: the fields, with the limits that were used.
    """

    scene: Scene
    start: Scene
    before: float
    after: float
    searched_before: float
    searched_after: float
    evaluations: int
    seconds: float
    searched: tuple[Searched, ...]

    def view(self) -> dict[str, Any]:
        """Return what the report shows."""
        rows = []
        for field, low, high in self.searched:
            rows.append(
                {
                    "field": field,
                    "before": _said(get(self.start, field)),
                    "after": _said(get(self.scene, field)),
                    "within": f"{low:g} to {high:g}",
                }
            )
        return {"lead": self.said(), "rows": rows}

    def said(self) -> str:
        """Return what it has brought, as a sentence."""
        took = f"{self.evaluations} evaluations in {self.seconds:.0f} s"
        if self.scene is self.start:
            return f"{took} found no better ranges: the scene stays as it was."
        return (
            f"{took} brought the mean distance from {self.before:.3f} to {self.after:.3f}; on the "
            f"shots that the search looked at, from {self.searched_before:.3f} to "
            f"{self.searched_after:.3f}."
        )


def fit(
    start: Scene,
    crops: Crops,
    real: Rows,
    evaluations: int,
    seconds: float,
    seed: int,
    tell: Callable[[str], None],
    searched: Sequence[Searched] | None = None,
) -> Fitted:
    """Search the ranges of a scene, from its own on; Ctrl-C ends the search, and the best so far is
    judged.

    Args:
        start: the scene to begin with; what is not searched stays as it is.
        crops: with originals. real: their statistics.
        evaluations: of the search, at most. seconds: it ends with the generation that reaches
            them.
        seed: of the shots that judge. The search and its shots have the next one.
        tell: takes a line of progress.
        searched: the fields; None is `searched_of` the scene.

    Raises:
        ValueError: crops without originals.

    Returns:
        The best scene of the search, or `start` where that is no better in other shots.
    """
    import cma  # takes seconds to import

    began = time.perf_counter()
    chosen = np.unique(np.linspace(0, len(real) - 1, min(CROPS, len(real))).round().astype(int))
    if crops.originals is None:
        raise ValueError("a fit needs the pictures that were on the screen; got photos alone.")
    originals = crops.originals[torch.from_numpy(chosen)]
    wanted = [real[i] for i in chosen]

    limits = tuple(_widened(start, one) for one in searched or searched_of(start))
    first = apart(start, originals, wanted, seed + 1)
    best, least, count = start, first, 1
    tell(f"fit: distance {first:.3f} at the start")
    options = {"bounds": [0, 1], "seed": seed + 1, "verbose": -9}
    search = cma.CMAEvolutionStrategy(encode(start, limits), STEP, options)
    try:
        while count < evaluations and time.perf_counter() - began < seconds and not search.stop():
            points = search.ask()
            values = []
            for point in points[: evaluations - count]:
                scene = decode(start, limits, point)
                value = REFUSED
                if scene is not None:
                    value = apart(scene, originals, wanted, seed + 1)
                if scene is not None and value < least:
                    best, least = scene, value
                values.append(value)
                count += 1
            tell(f"fit: distance {least:.3f} after {count} evaluations")
            if len(values) == len(points):
                search.tell(points, values)
    except KeyboardInterrupt:
        tell(f"fit: interrupted after {count} evaluations; the best so far is kept")
    if best is not start:
        best = rounded(best, limits)
    before, after = (apart(scene, crops.originals, real, seed) for scene in (start, best))
    if after >= before:
        best, after = start, before
    return Fitted(
        scene=best,
        start=start,
        before=before,
        after=after,
        searched_before=first,
        searched_after=apart(best, originals, wanted, seed + 1),
        evaluations=count,
        seconds=time.perf_counter() - began,
        searched=limits,
    )


def apart(scene: Scene, originals: Tensor, real: Rows, seed: int) -> float:
    """Return the mean distance of a scene's photos of crops from the statistics of the real
    ones."""
    photos = photographed(scene, originals, seed)
    return distance(lines(real, measured(photos, originals)))


def get(scene: Scene, field: str) -> tuple[float, float]:
    """Return the range of a field, "part.field"."""
    part, name = field.split(".")
    return bounds(getattr(getattr(scene, part), name))


def with_ranges(scene: Scene, ranges: Mapping[str, tuple[float, float]]) -> Scene:
    """Return a scene with other ranges of some fields.

    Raises:
        ValueError: ranges that the scene refuses.
    """
    parts: dict[str, dict[str, Any]] = {}
    for field, value in ranges.items():
        part, name = field.split(".")
        parts.setdefault(part, {})[name] = value
    changed = {part: replace(getattr(scene, part), **new) for part, new in parts.items()}
    return replace(scene, **changed)


def _widened(scene: Scene, one: Searched) -> Searched:
    low, high = get(scene, one.field)
    return Searched(one.field, min(low, one.low), max(high, one.high))


def encode(scene: Scene, limits: Sequence[Searched]) -> NDArray[np.float64]:
    """Return a scene's ranges as numbers in [0, 1]: the low end of each, and its width."""
    found = []
    for field, low, high in limits:
        begin, end = get(scene, field)
        found += [(begin - low) / (high - low), (end - begin) / (high - low)]
    return np.clip(found, 0.01, 0.99)


def decode(scene: Scene, limits: Sequence[Searched], point: NDArray[np.float64]) -> Scene | None:
    """Return the scene that these numbers encode; None if no scene can have its ranges."""
    ranges = {}
    for (field, low, high), (begin, width) in zip(limits, point.reshape(-1, 2), strict=True):
        first = low + (high - low) * min(float(begin), 1 - NARROWEST)
        last = min(high, first + (high - low) * max(float(width), NARROWEST))
        ranges[field] = (first, last)
    try:
        found = with_ranges(scene, ranges)
        found.plan()
    except ValueError:
        return None
    return found


def rounded(scene: Scene, limits: Sequence[Searched]) -> Scene:
    """Return a scene with its searched ranges rounded to four digits; a range that would lose its
    width, and with it its draws, stays."""
    ranges = {}
    for field, _, _ in limits:
        first, last = get(scene, field)
        low, high = float(f"{first:.4g}"), float(f"{last:.4g}")
        if low < high:
            ranges[field] = low, high
    return with_ranges(scene, ranges)


def _said(values: tuple[float, float]) -> str:
    low, high = values
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
