"""The moiré's own spectrum: its strongest peaks, and whether it is stripes or a lattice.

Windows of a crop's flattest places are Fourier transformed one by one, as the moiré of an oblique
screen changes from place to place (Welch, 1967, without the averaging). The power of the picture's
own content in the same window is subtracted, and so is the noise floor.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import maximum_filter

Plane = NDArray[Any]  # of float32
Power = NDArray[Any]

WINDOW_SIDE = 96  # pixels
WINDOW_SHARE = 0.4  # of the windows, the flattest
MIN_FREQUENCY, MAX_FREQUENCY = 1 / 32, 1 / 4  # cycles per pixel: the band that is searched
OCTAVE_EDGES = (MIN_FREQUENCY, 1 / 16, 1 / 8, MAX_FREQUENCY)  # each octave has its own noise floor
NOISE_FACTOR = 2.0  # times the floor: a seventh of the power of white noise stays
PEAK_NOISE_FACTOR = 20.0  # times the floor: fewer than one in 10^8 values of white noise exceed it
MIN_PEAK_STRENGTH = 0.25  # codes RMS
MIN_PEAK_SHARE = 0.1  # of the strength of the crop's strongest peak


class Peak(NamedTuple):
    """A sinusoid in a window of a crop.

    Args:
        frequency: frequency, in cycles per pixel.
        angle: angle of the wave vector, which crosses the stripes, in degrees in [0, 180),
            counter-clockwise as seen in the picture.
        strength: RMS over the planes together, in codes.
    """

    frequency: float
    angle: float
    strength: float


class Spectrum(NamedTuple):
    """Power of the windows of a crop over frequency, (windows, n, n), zero frequency in the middle,
    in codes squared: the sum over a window's bins is its mean square under a Hann window."""

    power: Power
    floor: Power

    @property
    def excess(self) -> Power:
        """Power above the noise, in the band that is searched."""
        above_noise = self.power - NOISE_FACTOR * self.floor
        return np.where(_band(self.power.shape[-1]), above_noise, 0).clip(0)


def spectrum(planes: Sequence[Plane], content: Sequence[Plane] | None, busy: Plane) -> Spectrum:
    """Return the power of some planes in the flattest windows of a crop.

    Args:
        planes: (H, W) each, in codes; their powers are added.
        content: the same planes of the picture that is shown, whose power is subtracted.
        busy: (H, W) amount of detail in the picture.
    """
    places = _flattest(busy)
    power = np.sum([_power(plane, places) for plane in planes], axis=0)
    if content is not None:
        content_power = np.sum([_power(plane, places) for plane in content], axis=0)
        power = np.clip(power - content_power, 0, None)
    return Spectrum(power, _floor(power))


def side_of(shape: tuple[int, ...]) -> int:
    """Return the side of a window in a crop of that shape."""
    return min(WINDOW_SIDE, *shape)


def _flattest(busy: Plane) -> list[tuple[slice, slice]]:
    side = side_of(busy.shape)
    windows = []
    for y in range(0, busy.shape[0] - side + 1, max(1, side // 2)):
        for x in range(0, busy.shape[1] - side + 1, max(1, side // 2)):
            place = (slice(y, y + side), slice(x, x + side))
            windows.append((float(busy[place].mean()), y, x, place))
    windows.sort(key=lambda entry: entry[:3])
    return [place for *_, place in windows[: max(1, round(WINDOW_SHARE * len(windows)))]]


def _power(plane: Plane, places: Sequence[tuple[slice, slice]]) -> Power:
    taper = _taper(side_of(plane.shape))
    windows = np.stack([plane[place] for place in places])
    windows = (windows - _weighted_mean(windows, taper)) * taper
    transform = fft.fft2(windows)
    power = transform.real**2 + transform.imag**2
    n = taper.shape[0]
    return fft.fftshift(power, axes=(-2, -1)) / (n * n * np.square(taper).sum())


def _weighted_mean(windows: Plane, taper: Plane) -> Plane:
    return (windows * taper).sum((1, 2), keepdims=True) / taper.sum()


@cache
def _taper(side: int) -> Plane:
    hann = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
    return (hann[:, None] * hann).astype(np.float32)


@cache
def _frequencies(side: int) -> tuple[Power, Power, Power]:
    """Return frequency along x and y, and its length, (side, side) each, in cycles per pixel."""
    f = fft.fftshift(fft.fftfreq(side))
    fx, fy = np.meshgrid(f, f)
    return fx, fy, np.hypot(fx, fy)


@cache
def _band(side: int) -> NDArray[np.bool_]:
    length = _frequencies(side)[2]
    return (length >= MIN_FREQUENCY) & (length <= MAX_FREQUENCY)


def _floor(power: Power) -> Power:
    """Return the mean power of the noise by octaves, from the median, which peaks do not move."""
    length = _frequencies(power.shape[-1])[2]
    floor = np.zeros_like(power)
    for low, high in pairwise(OCTAVE_EDGES):
        ring = (length >= low) & (length <= high)
        if ring.any():
            floor[:, ring] = np.median(power[:, ring], axis=1, keepdims=True) / np.log(2)
    return floor


def two_dimensionality(spectrum: Spectrum) -> float:
    """Return 0 where each window holds one family of stripes, 1 where it holds a square lattice, or
    noise that has no direction.

    It is twice the lesser eigenvalue of the second moment matrix of the wave vectors' directions,
    weighted by their power above the noise and divided by its trace; a mean over the windows,
    weighted by their power. Harmonics lie in the direction of their stripes, and change nothing.
    0 where there is no power at all."""
    fx, fy, length = _frequencies(spectrum.power.shape[-1])
    safe = np.where(length > 0, length, 1)
    ux, uy = fx / safe, fy / safe
    excess = spectrum.excess
    xx, yy = (excess * ux * ux).sum((1, 2)), (excess * uy * uy).sum((1, 2))
    xy = (excess * ux * uy).sum((1, 2))
    trace = xx + yy
    lesser = (trace - np.hypot(xx - yy, 2 * xy)) / 2
    total = float(trace.sum())
    return float(2 * lesser.sum() / total) if total > 1e-9 else 0.0


def peaks(spectrum: Spectrum) -> list[list[Peak]]:
    """Return the peaks of each window, the strongest first."""
    side = spectrum.power.shape[-1]
    fx, fy, _ = _frequencies(side)
    half = _band(side) & ((fy > 0) | ((fy == 0) & (fx > 0)))
    windows = []
    for power, floor in zip(spectrum.power, spectrum.floor, strict=True):
        highest = maximum_filter(power, 5, mode="wrap")
        places = np.argwhere(half & (power == highest) & (power > PEAK_NOISE_FACTOR * floor))
        window = [_peak(power - floor, y, x) for y, x in places]
        windows.append(sorted(window, key=lambda peak: -peak.strength))
    strongest = max((window[0].strength for window in windows if window), default=0.0)
    min_strength = max(MIN_PEAK_STRENGTH, MIN_PEAK_SHARE * strongest)
    return [[peak for peak in window if peak.strength >= min_strength] for window in windows]


def _peak(power: Power, y: int, x: int) -> Peak:
    """Return the peak at a bin: all of a Hann window's main lobe, 5 x 5 bins."""
    fx, fy, _ = _frequencies(len(power))
    lobe = (slice(max(0, y - 2), y + 3), slice(max(0, x - 2), x + 3))
    weight = power[lobe].clip(0)
    total = float(weight.sum())
    right, down = float((weight * fx[lobe]).sum() / total), float((weight * fy[lobe]).sum() / total)
    angle = float(np.degrees(np.arctan2(-down, right)) % 180)
    # a real sinusoid has a second lobe at minus its frequency
    return Peak(float(np.hypot(right, down)), angle, float(np.sqrt(2 * total)))
