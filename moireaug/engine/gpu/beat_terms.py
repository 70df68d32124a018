"""Which aliases of which harmonics a batch's binned readings show, in numpy, for a GPU; see
`exposure.alias_transfer`.

Bounds over the photo decide, from the ranges of frequencies at a few of its points. CPU kernels
choose by themselves, in `cpu.beat_terms`: for a single photo, this takes nine times as long, and
numba would compile for seconds where Triton needs none of it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch

from moireaug.common.physics import aliases, bins, lens, optics
from moireaug.engine.lower.budget import MAX_MOTION_RANGE, TRANSFER_MARGIN
from moireaug.engine.lower.exposure_records import Beats, Camera, Exposure
from moireaug.scene.geometry.distortion import inverse_radial_factor

Arrays = tuple[np.ndarray, ...]

VIEW_SAMPLES = 5  # along each axis of the photo
TRANSFER_SAMPLES = 2  # every how many of them the optics' transfer is taken
MAX_FREQUENCY_RANGE = 16.0  # over the photo, cycles per sensor pixel; it has two aliases a cycle


def cameras_of(cameras: np.ndarray) -> Any:
    """Return the fields (B, fields) of a batch's cameras as one Camera of arrays (B, 1, 1), which
    broadcast over points."""
    return Camera(*cameras.T[:, :, None, None])


def jacobian(u: np.ndarray, v: np.ndarray, c: Any) -> Arrays:
    """Return `lens.panel_jacobian`, (B, h, w) each, at photo points about the centre; of rectified
    cameras, at where the photos show image points. c: from `cameras_of`."""
    if c.rectified.any():
        u, v = to_photo(u, v, c)
    return lens.panel_jacobian(u, v, c)


def to_photo(x: np.ndarray, y: np.ndarray, c: Any) -> Arrays:
    """Return where image points lie on the photos, both about the centre, (B, h, w) each."""
    u, v = lens.project(x, y, forward(c).reshape(-1, 9).T[:, :, None, None])
    if c.k1.any() or c.k2.any():
        points = torch.from_numpy(np.stack([u, v], -1).reshape(len(u), -1, 2))
        fields = (c.k1, c.k2, c.photo_height, c.photo_width)
        k1, k2, height, width = (torch.from_numpy(field[:, 0, 0]) for field in fields)
        factor = inverse_radial_factor(points, k1, k2, (height, width)).numpy().reshape(u.shape)
        u, v = u * factor, v * factor
    return u, v


def forward(c: Any) -> np.ndarray:
    """Return the homographies from image to ideal photo coordinates, (B, 3, 3)."""
    return np.linalg.inv(np.stack(c[:9], -1).reshape(-1, 3, 3))


class BeatTerms(NamedTuple):
    """The harmonics of a batch's images, one image after another, and their aliases.

    Args:
        harmonic: (H,) int64, rows of `Beats.orders`. harmonic_start: (B + 1,) int64, each image's
            first.
        alias: (T, 2) int64, m along u and v. alias_start: (H + 1,) int64, each harmonic's first.
        fits: (B,) bool, false for images whose frequencies differ too much over the photo; none of
            their terms are here.
    """

    harmonic: np.ndarray
    harmonic_start: np.ndarray
    alias: np.ndarray
    alias_start: np.ndarray
    fits: np.ndarray


def beat_terms(exposure: Exposure, beats: Beats) -> BeatTerms:
    """Return the terms whose amplitude may exceed `ErrorBudget.beat_amplitude` somewhere."""
    least, camera = exposure.budget.beat_amplitude, cameras_of(beats.cameras)
    us, vs = _samples(exposure.sites.cols), _samples(exposure.sites.rows)
    step = jacobian(us + camera.centre_u, vs[:, None] + camera.centre_v, camera)
    strength = _max_strength(step, camera, beats)
    image, harmonic = np.nonzero(strength > least)
    u, v = _frequencies(step, image, harmonic, beats)
    differ = np.maximum(np.ptp(u, 1), np.ptp(v, 1)) > MAX_FREQUENCY_RANGE
    fits = np.ones(len(beats.cameras), bool)
    fits[image[differ]] = False
    fitting = fits[image]
    image, harmonic, u, v = image[fitting], harmonic[fitting], u[fitting], v[fitting]
    along_u, along_v = _aliases(u, beats.bayer), _aliases(v, beats.bayer)
    m_u, m_v = along_u.m[:, :, None], along_v.m[:, None]
    transfer = along_u.passed[:, :, None] * along_v.passed[:, None]
    for side in _sides(step, camera, beats):
        transfer *= _max_mean(u, v, side[:, image], m_u, m_v)
    even_u, even_v = along_u.interpolated[:, :, None], along_v.interpolated[:, None]
    both = even_u * even_v
    transfer *= np.where((m_u + m_v) % 2 == 0, np.maximum(both, (even_u + even_v) / 2), both)
    chosen = transfer * strength[image, harmonic][:, None, None] > least
    h, i, j = np.nonzero(chosen)
    some = chosen.any((1, 2))
    return BeatTerms(
        harmonic[some],
        _starts(image[some], len(fits)),
        np.stack([along_u.m[h, i], along_v.m[h, j]], 1),
        _starts((np.cumsum(some) - 1)[h], int(some.sum())),
        fits,
    )


def _samples(positions: np.ndarray) -> np.ndarray:
    """Return VIEW_SAMPLES positions from the first to the last."""
    return positions[(len(positions) - 1) * np.arange(VIEW_SAMPLES) // (VIEW_SAMPLES - 1)]


def _frequencies(
    step: Arrays, image: np.ndarray, harmonic: np.ndarray, beats: Beats
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies of harmonics of images along u and v at the samples, in cycles per
    sensor pixel, (H, samples) each."""
    k, l = (beats.orders[harmonic] / beats.period).T[:, :, None]
    xu, xv, yu, yv = (part.reshape(len(part), -1)[image] for part in step)
    return k * xu + l * yu, k * xv + l * yv


def _max_strength(step: Arrays, c: Any, beats: Beats) -> np.ndarray:
    """Return the greatest amplitude of each harmonic behind the optics and the gain, (B, K)."""
    coarse = [part[:, ::TRANSFER_SAMPLES, ::TRANSFER_SAMPLES] for part in step]
    xu, xv, yu, yv = (part.reshape(len(part), 1, -1) for part in coarse)
    k, l = (beats.orders / beats.period).T[:, :, None]
    fu, fv = k * xu + l * yu, k * xv + l * yv  # (B, K, samples)
    passed = optics.transfer(fu, fv, (c.fill, c.blur, c.olpf, c.motion_x, c.motion_y))
    # motion passes waves along which it runs, which may be between the samples
    along = fu * c.motion_x + fv * c.motion_y
    low, high = along.min(2, keepdims=True), along.max(2, keepdims=True)
    is_between = (low < 0) & (high > 0) & (high - low > MAX_MOTION_RANGE)
    still = optics.transfer(fu, fv, (c.fill, c.blur, c.olpf, 0.0, 0.0))
    passed = np.where(is_between, still, passed)
    most = np.minimum(TRANSFER_MARGIN * np.abs(passed).max(2, initial=0), 1)
    return beats.strength * most * np.maximum(c.gain[:, :, 0], 1)


def _sides(step: Arrays, c: Any, beats: Beats) -> tuple[np.ndarray, np.ndarray]:
    """Return u and v of the bins' two sides at the samples, in sensor pixels, (2, B, samples)
    each."""
    xu, xv, yu, yv = (part.reshape(len(part), -1) for part in step)
    enlargement, zero = beats.enlargement[:, None], np.zeros_like(xu)
    if beats.sampled:
        return np.stack([zero + 1, zero]), np.stack([zero, zero + 1])
    if not c.rectified.any():
        across, down = c.scale_u[:, :, 0] * enlargement, c.scale_v[:, :, 0] * enlargement
        return np.stack([zero + across, zero]), np.stack([zero, zero + down])
    first, second = bins.image_pixel_sides(xu, xv, yu, yv, c.alpha[:, :, 0] * enlargement)
    return np.stack(first), np.stack(second)


class _Aliases(NamedTuple):
    """The aliases m of harmonics along one axis, and the most that is left of each by holding
    values over pixels and by interpolation between them; (H, M) each."""

    m: np.ndarray
    passed: np.ndarray
    interpolated: np.ndarray


def _aliases(frequency: np.ndarray, bayer: bool) -> _Aliases:
    """Return the aliases along one axis of harmonics at samples (H, samples)."""
    low, high = frequency.min(1), frequency.max(1)
    first = np.floor(2 * low).astype(np.int64) - 1
    count = int((np.floor(2 * high) - first).max(initial=0)) + 3
    m = first[:, None] + np.arange(count)
    below, above = low[:, None] - m / 2, high[:, None] - m / 2
    passed = aliases.max_hold_transfer(low[:, None], high[:, None], m)
    if not bayer:  # pixels lie one apart: every second alias is none
        return _Aliases(m, np.where(m % 2 == 0, passed, 0), np.ones_like(passed))
    ends = np.maximum(np.cos(math.pi * below) ** 2, np.cos(math.pi * above) ** 2)
    has_peak = np.floor(above) >= np.ceil(below)
    return _Aliases(m, passed, np.where(has_peak, 1.0, ends))


def _max_mean(
    u: np.ndarray, v: np.ndarray, side: np.ndarray, m_u: np.ndarray, m_v: np.ndarray
) -> np.ndarray:
    """Return the most that the mean along a side of the bins leaves of aliases, (H, M, M).

    Args:
        u, v: (H, samples), frequencies. side: (2, H, samples), see `_sides`.
        m_u: (H, M, 1). m_v: (H, 1, M).
    """
    ranges = []
    for values in (u * side[0] + v * side[1], *side):
        ranges.append([end(1)[:, None, None] for end in (values.min, values.max)])
    cycles, side_u, side_v = ranges
    return aliases.max_mean_transfer(cycles, side_u, side_v, m_u, m_v)


def _starts(group: np.ndarray, count: int) -> np.ndarray:
    """Return where each of `count` groups begins in a sorted list of their numbers, and where the
    last ends, (count + 1,)."""
    return np.searchsorted(group, np.arange(count + 1))
