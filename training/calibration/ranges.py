"""The fields of a scene that a fit searches, their limits, and the encoding of their ranges."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moireaug import Scene
from moireaug.scene.by_name import with_values
from moireaug.scene.fields import bounds

# share of a field's limits: a range without width draws no number, and shifts others' draws
MIN_WIDTH = 1e-6


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
)
SCALE_FIELD = SearchedField("panel.scale", 0.4, 2.0)


def fields_to_search(scene: Scene) -> tuple[SearchedField, ...]:
    """Return the fields of a scene to search. Width and pitch of a screen are ranges in a binned
    reading alone."""
    fields = [one for one in SCREEN_FIELDS if scene.is_binned and range_of(scene, one.field)[1]]
    if not range_of(scene, "panel.width")[1]:
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


def rounded(scene: Scene, limits: Sequence[SearchedField]) -> Scene:
    """Return a scene with its searched ranges rounded to four digits; a range that would lose its
    width, and with it its draws, stays."""
    ranges = {}
    for field, _, _ in limits:
        first, last = range_of(scene, field)
        low, high = float(f"{first:.4g}"), float(f"{last:.4g}")
        if low < high:
            ranges[field] = low, high
    return with_values(scene, ranges)
