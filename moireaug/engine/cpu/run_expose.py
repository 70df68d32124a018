"""Exposing of batches: tensors in and out."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from torch import Tensor

from moireaug.engine.cpu import batch_expose as batch
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.first_use import prepare
from moireaug.engine.cpu.threads import each, each_share, surplus
from moireaug.engine.lower.exposure_records import Beats, Exposure

SHOWN_VALUES_AT_ONCE = 2**16  # of small panels, which are filled before any is read


def fits(exposure: Exposure, beats: Beats | None) -> np.ndarray:
    """Return for each image whether `expose` can follow its view, (B,) bool; see
    `batch_expose.views_fit`."""
    cold = prepare()
    if exposure.point:
        return np.ones(len(exposure.cameras), bool)
    fitting = batch.views_fit(exposure)
    if beats is not None and len(beats.orders):
        fitting &= batch.beats_fit(exposure, beats)
    reading = batch.expose if beats is None else batch.expose_binned
    if cold and fitting.any() and not reading.signatures:
        # before `show`, which the other process compiles in the meantime
        compile_expose(exposure, beats)
    return fitting


def compile_expose(exposure: Exposure, beats: Beats | None) -> None:
    """Compile the kernel of exposing, by exposing nothing."""
    readings, shown = np.empty((0, 1, 0, 0), np.float32), np.empty((0, 0), np.float32)
    _reader(readings, readings, exposure, beats)(shown, 0, 0, 0, 0)


def compile_show(exposure: Exposure) -> None:
    """Compile the kernel that shows float32 pictures, by showing none."""
    shown, pictures = np.empty((0, 0), np.float32), np.empty((0, 3, 0, 0), np.float32)
    batch.show(shown, light_of(exposure), pictures, exposure, 0, 0)


def expose(
    picture: Tensor, saves: bool, exposure: Exposure, beats: Beats | None
) -> tuple[Tensor, Tensor]:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8, and
    a tensor that `expose_back` takes: the readings' derivative in the light before noise and
    clipping.

    saves: `expose_back` will be called; else that tensor is empty.
    """
    prepare()
    sites, n = exposure.sites, len(picture)
    h, w = len(sites.rows) // sites.step, len(sites.cols) // sites.step
    raw, slopes = empty(n, len(sites.channel), h, w), empty(n, len(sites.channel), h, saves * w)
    pictures = array_of(picture)
    if exposure.point:
        each(functools.partial(_expose_points, raw.numpy(), slopes.numpy(), pictures, exposure), n)
        return raw, slopes
    whole, read = n - surplus(n, h), _reader(raw.numpy(), slopes.numpy(), exposure, beats)
    each(functools.partial(_expose_images, read, pictures, exposure), whole)
    for i in range(whole, n):
        _expose_shared(read, pictures, exposure, i, h)
    return raw, slopes


def _expose_points(
    readings: np.ndarray,
    slopes: np.ndarray,
    pictures: np.ndarray,
    exposure: Exposure,
    first: int,
    last: int,
) -> None:
    """Fill the readings from `first` to `last` of a point exposure."""
    batch.expose_points(readings, slopes, light_of(exposure), pictures, exposure, first, last)


def _reader(
    readings: np.ndarray, slopes: np.ndarray, exposure: Exposure, beats: Beats | None
) -> Callable[..., None]:
    """Return a function that fills rows of some readings, full or binned, from what is shown."""

    def read(shown: np.ndarray, first: int, last: int, top: int, bottom: int) -> None:
        if beats is None:
            batch.expose(readings, slopes, shown, exposure, first, last, top, bottom)
        else:
            batch.expose_binned(readings, slopes, shown, exposure, beats, first, last, top, bottom)

    return read


def _expose_images(
    read: Callable[..., None], pictures: np.ndarray, exposure: Exposure, first: int, last: int
) -> None:
    """Fill the readings from `first` to `last`: show some pictures, then read them."""
    light, shown = light_of(exposure), shown_of(exposure)
    rows = len(exposure.sites.rows) // exposure.sites.step
    for start in range(first, last, len(shown)):
        end = min(start + len(shown), last)
        batch.show(shown, light, pictures, exposure, start, end)
        read(shown, start, end, 0, rows)


def _expose_shared(
    read: Callable[..., None], pictures: np.ndarray, exposure: Exposure, i: int, rows: int
) -> None:
    """Fill reading i: all threads share its rows."""
    shown = np.empty((1, batch.panel_size(exposure)), np.float32)
    batch.show(shown, light_of(exposure), pictures, exposure, i, i + 1)
    each_share(functools.partial(read, shown, i, i + 1), rows)


def shown_of(exposure: Exposure) -> np.ndarray:
    """Return workspace for some pictures as the panel shows them, (n,
    `batch_expose.panel_size`)."""
    size = batch.panel_size(exposure)
    return np.empty((max(1, SHOWN_VALUES_AT_ONCE // size), size), np.float32)


def light_of(exposure: Exposure) -> np.ndarray:
    """Return workspace for a picture's light, (3, H, W) float32."""
    return np.empty((3, *exposure.size), np.float32)
