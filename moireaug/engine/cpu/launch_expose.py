"""Exposing of batches, and its gradient: tensors in and out."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.cpu import expose_back_kernels as back_kernels
from moireaug.engine.cpu import expose_kernels as kernels
from moireaug.engine.cpu.arrays import array_of, empty
from moireaug.engine.cpu.records import Span
from moireaug.engine.cpu.threads import run_in_parts, run_in_shares, surplus_images
from moireaug.engine.lower.exposure_records import (
    BinnedView,
    Exposure,
    FullView,
    PanelView,
    PointView,
)


class ExposeKernels(NamedTuple):
    """The kernels of a kind of reading: of what varies slowly over a photo, of rows of one, and of
    the gradient of one."""

    setup: Callable
    expose: Callable
    expose_back: Callable


KERNELS_OF_VIEW = {
    FullView: ExposeKernels(
        kernels.full_grid_kernel,
        kernels.expose_full_kernel,
        back_kernels.expose_full_back_kernel,
    ),
    BinnedView: ExposeKernels(
        kernels.binned_setup_kernel,
        kernels.expose_binned_kernel,
        back_kernels.expose_binned_back_kernel,
    ),
    PointView: ExposeKernels(
        lambda exposure, view, i: None,
        kernels.expose_point_kernel,
        back_kernels.expose_point_back_kernel,
    ),
}


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


def compile_show(exposure: Exposure, dtype: torch.dtype) -> None:
    """Compile the kernel that shows pictures of a dtype, by showing one."""
    pictures = torch.zeros(1, 3, *exposure.size, dtype=dtype).numpy()
    kernels.show_kernel(*_buffers(exposure, False), pictures, exposure, False, 0)


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
    view_kernels, at_points = KERNELS_OF_VIEW[type(view)], isinstance(view, PointView)

    def read(i: int, buffers: tuple[np.ndarray, np.ndarray], each_part: Callable) -> None:
        setup = view_kernels.setup(exposure, view, i)
        kernels.show_kernel(*buffers, pictures, exposure, at_points, i)

        def read_rows(top: int, bottom: int) -> None:
            span = Span(i, top, bottom)
            view_kernels.expose(*arrays, buffers[0], exposure, view, setup, span)

        each_part(read_rows, h)

    def read_images(first: int, last: int) -> None:
        buffers = _buffers(exposure, at_points)
        for i in range(first, last):
            read(i, buffers, lambda read_rows, h: read_rows(0, h))

    whole = n - surplus_images(n, h)
    run_in_parts(read_images, whole)
    for i in range(whole, n):
        read(i, _buffers(exposure, at_points), run_in_shares)
    return raw, slopes


def launch_expose_back(
    grad: Tensor, picture: Tensor, slopes: Tensor, exposure: Exposure, view: PanelView
) -> Tensor:
    """Return the gradient in pictures (B, 3, H, W) float32, from that in their readings and what
    `launch_expose` saved."""
    out = empty(*picture.shape)
    grads, pictures, read_grads = out.numpy(), array_of(picture), (array_of(grad), slopes.numpy())
    view_kernels, at_points = KERNELS_OF_VIEW[type(view)], isinstance(view, PointView)

    def fill_grads(first: int, last: int) -> None:
        shown_grad, light_grad = _buffers(exposure, at_points)
        for i in range(first, last):
            setup = view_kernels.setup(exposure, view, i)
            view_kernels.expose_back(shown_grad, *read_grads, exposure, view, setup, i)
            given = pictures, exposure, at_points, i
            back_kernels.show_back_kernel(grads, shown_grad, light_grad, *given)

    run_in_parts(fill_grads, len(picture))
    return out


def _buffers(exposure: Exposure, at_points: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return workspace for a picture as the panel shows it, (`expose_kernels.shown_length`,)
    float32, and for its light, (3, H, W) float32."""
    shown = np.empty(kernels.shown_length(exposure, at_points), np.float32)
    return shown, np.empty((3, *exposure.size), np.float32)
