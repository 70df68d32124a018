"""The exposure method of a scene, and the harmonics and panel pixels that it sums."""

from __future__ import annotations

import functools
import math

from moireaug.camera.exposure import extreme_readings
from moireaug.camera.exposure.binned import Binned
from moireaug.camera.exposure.full import Box, Mean, Spectral
from moireaug.camera.exposure.sampled import Point, Supersample
from moireaug.scene.exposure_method import ExposureMethod
from moireaug.scene.record import SceneRecord

# a magnified screen with more harmonics than this is integrated by overlaps instead, or, in bins,
# loses the weakest, as `effects.exposure.PanelLayout` says
MAX_HARMONICS = 1024
FINE_APERTURE = 0.25  # cells: shares of a smaller aperture are differences too small for float32
# panel pixels along an axis that one sensor pixel sees; if it sees more, the picture is blurred
# first
MAX_TAPS = 7


@functools.lru_cache(maxsize=512)
def method_of(scene: SceneRecord) -> ExposureMethod:
    """Return the method that a scene's `Sensor.exposure` names; for "auto" the cheapest that meets
    its tolerance.

    "auto" is `spectral` where harmonics of up to order 29 per panel pixel, and at most 1024 of
    them, carry all contrast above the tolerance, or where subpixels are slanted; else `box`.

    Raises:
        ValueError: "point" or "box" for a panel whose subpixels are not rectangles.
    """
    if scene.is_binned:
        return _binned(scene)
    method, _, n = scene.sensor.exposure.partition(":")
    slanted = [s for s in scene.panel.cell.all() if not s.is_rectangle]
    if method in ("point", "box") and slanted:
        raise ValueError(
            f"Sensor.exposure = {method!r} takes subpixels for rectangles; this Panel.layout has "
            f"slanted ones, the first {slanted[0]!r}. Use 'auto' or 'supersample:8'."
        )
    if method == "point":
        return Point(has_black_matrix=scene.panel.has_black_matrix)
    if method == "supersample":
        return Supersample(int(n))
    taps = taps_of(scene)
    in_float64 = extreme_readings.min_aperture_width(scene) < FINE_APERTURE
    if method == "mean":
        return Mean(taps, in_float64=in_float64)
    if method == "box":
        return Box(taps, in_float64=True)
    harmonics = extreme_readings.harmonics(scene)
    endless = len(harmonics) > MAX_HARMONICS or _is_cut(scene, harmonics)
    if method == "auto" and endless and not slanted:
        return Box(taps, in_float64=True)
    return Spectral(taps, tuple(pair for pair, _ in harmonics), in_float64=in_float64)


def _binned(scene: SceneRecord) -> Binned:
    taps = taps_of(scene)
    if scene.sensor.exposure == "mean":
        return Binned(taps, (), name="mean")
    harmonics = extreme_readings.harmonics_in_bins(scene)[:MAX_HARMONICS]
    return Binned(taps, tuple(pair for pair, _ in harmonics), name="spectral")


def _is_cut(scene: SceneRecord, harmonics: list[tuple[tuple[int, int], float]]) -> bool:
    """Whether the series would go on past the highest order. Every third order of a stripe is
    empty, so any of the last three decides."""
    px, py = scene.panel.cell.period
    last = extreme_readings.HIGHEST_ORDER - 3
    return any(max(abs(k) / px, abs(l) / py) > last for (k, l), _ in harmonics)


def taps_of(scene: SceneRecord) -> int:
    """Return how many panel pixels along an axis a sensor pixel must see: 1, 3, 5 or 7."""
    return min(2 * math.floor(extreme_readings.max_reach(scene) + 0.5) + 1, MAX_TAPS)
