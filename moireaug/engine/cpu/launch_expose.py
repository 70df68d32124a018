"""Exposing of batches, and its gradient: tensors in and out."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from torch import Tensor

from moireaug.engine.cpu import expose_back_kernels as back_kernels
from moireaug.engine.cpu import expose_kernels as kernels
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.first_use import prepare_back
from moireaug.engine.cpu.records import Span
from moireaug.engine.cpu.threads import each, each_share, surplus
from moireaug.engine.lower.exposure_records import (
    BinnedView,
    Exposure,
    FullView,
    PanelView,
    PointView,
)

Reader = Callable[[np.ndarray, Span], None]  # fills a part of the readings from what is shown
READING_KERNELS = {FullView: kernels.expose_full_kernel, BinnedView: kernels.expose_binned_kernel}
READING_BACK_KERNELS = {
    FullView: back_kernels.expose_full_back_kernel,
    BinnedView: back_kernels.expose_binned_back_kernel,
}
SHOWN_VALUES_AT_ONCE = 2**16  # of small panels, which are filled before any is read


def fits(exposure: Exposure, view: PanelView) -> np.ndarray:
    """Return for each image whether kernels can follow its view, (B,) bool; see
    `expose_kernels.views_fit`."""
    if isinstance(view, PointView):
        return np.ones(len(exposure.cameras), bool)
    if isinstance(view, FullView):
        return kernels.views_fit(exposure, view)
    fitting = kernels.views_fit(exposure, view.picture)
    if len(view.beats.orders):
        fitting &= kernels.beats_fit(exposure, view.beats)
    return fitting


def compile_show(exposure: Exposure) -> None:
    """Compile the kernel that shows float32 pictures, by showing none."""
    shown, pictures = np.empty((0, 0), np.float32), np.empty((0, 3, 0, 0), np.float32)
    kernels.show_kernel(shown, _light_of(exposure), pictures, exposure, 0, 0)


def launch_expose(
    picture: Tensor, saves: bool, exposure: Exposure, view: PanelView
) -> tuple[Tensor, Tensor]:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8, and
    a tensor that `launch_expose_back` takes: the readings' derivative in the light before noise and
    clipping.

    saves: `launch_expose_back` will be called; else that tensor is empty.
    """
    sites, n = exposure.sites, len(picture)
    h, w = len(sites.rows) // sites.step, len(sites.cols) // sites.step
    raw, slopes = empty(n, len(sites.channel), h, w), empty(n, len(sites.channel), h, saves * w)
    arrays, pictures = (raw.numpy(), slopes.numpy()), array_of(picture)
    if isinstance(view, PointView):

        def read_points(first: int, last: int) -> None:
            kernels.expose_point_kernel(*arrays, pictures, exposure, view, first, last)

        each(read_points, n)
        return raw, slopes
    whole, read = n - surplus(n, h), _reader(*arrays, exposure, view)
    each(functools.partial(_read_images, read, pictures, exposure), whole)
    for i in range(whole, n):
        _share_image(read, pictures, exposure, i, h)
    return raw, slopes


def launch_expose_back(
    grad: Tensor, picture: Tensor, slopes: Tensor, exposure: Exposure, view: PanelView
) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings and what
    `launch_expose` saved."""
    prepare_back()
    out = empty(*picture.shape)
    grads, pictures, read_grads = out.numpy(), array_of(picture), (array_of(grad), slopes.numpy())

    def point_grads(first: int, last: int) -> None:
        given = *read_grads, pictures, exposure, view, first, last
        back_kernels.expose_point_back_kernel(grads, *given)

    def image_grads(first: int, last: int) -> None:
        """Fill the gradients of what the panel shows, then of pictures."""
        light, shown = _light_of(exposure), _shown_of(exposure)
        for start in range(first, last, len(shown)):
            end = min(start + len(shown), last)
            READING_BACK_KERNELS[type(view)](shown, *read_grads, exposure, view, start, end)
            back_kernels.show_back_kernel(grads, shown, light, pictures, exposure, start, end)

    each(point_grads if isinstance(view, PointView) else image_grads, len(picture))
    return out


def _reader(
    readings: np.ndarray, slopes: np.ndarray, exposure: Exposure, view: PanelView
) -> Reader:
    """Return the Reader of some readings, full or binned, whose kernel is compiled."""
    kernel = READING_KERNELS[type(view)]

    def read(shown: np.ndarray, span: Span) -> None:
        kernel(readings, slopes, shown, exposure, view, span)

    if not kernel.signatures:  # before `show_kernel`, which another process compiles meanwhile
        read(np.empty((0, 0), np.float32), Span(0, 0, 0, 0))
    return read


def _read_images(
    read: Reader, pictures: np.ndarray, exposure: Exposure, first: int, last: int
) -> None:
    """Fill the readings from `first` to `last`: show some pictures, then read them."""
    light, shown = _light_of(exposure), _shown_of(exposure)
    rows = len(exposure.sites.rows) // exposure.sites.step
    for start in range(first, last, len(shown)):
        end = min(start + len(shown), last)
        kernels.show_kernel(shown, light, pictures, exposure, start, end)
        read(shown, Span(start, end, 0, rows))


def _share_image(read: Reader, pictures: np.ndarray, exposure: Exposure, i: int, rows: int) -> None:
    """Fill reading i: all threads share its rows."""
    shown = np.empty((1, kernels.panel_size(exposure)), np.float32)
    kernels.show_kernel(shown, _light_of(exposure), pictures, exposure, i, i + 1)
    each_share(lambda top, bottom: read(shown, Span(i, i + 1, top, bottom)), rows)


def _shown_of(exposure: Exposure) -> np.ndarray:
    """Return workspace for some pictures as the panel shows them, (n,
    `expose_kernels.panel_size`)."""
    size = kernels.panel_size(exposure)
    return np.empty((max(1, SHOWN_VALUES_AT_ONCE // size), size), np.float32)


def _light_of(exposure: Exposure) -> np.ndarray:
    """Return workspace for a picture's light, (3, H, W) float32."""
    return np.empty((3, *exposure.size), np.float32)
