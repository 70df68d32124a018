"""The CPU's kernels on batches; see `engine.backends.Backend.kernels`."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.cpu import develop_kernels, expose_kernels
from moireaug.engine.cpu import expose_back_kernels as back_kernels
from moireaug.engine.cpu.develop_arrays import develop_arrays
from moireaug.engine.cpu.first_use import prepare as prepare
from moireaug.engine.cpu.records import Photos, Span
from moireaug.engine.cpu.threads import run_in_parts, run_in_shares, surplus_images
from moireaug.engine.lower.development_records import Development
from moireaug.engine.lower.exposure_records import (
    BinnedView,
    Exposure,
    FullView,
    PanelView,
    PointView,
)

SUMS_IN_ORDER = True


def array_of(tensor: Tensor) -> np.ndarray:
    """Return a tensor's values, contiguous."""
    return tensor.detach().contiguous().numpy()


def empty(*shape: int) -> Tensor:
    """Return an uninitialised tensor, float32. NumPy asks for huge pages where it is large; with
    small ones a large photo takes a fifth longer."""
    return torch.from_numpy(np.empty(shape, np.float32))


# by kind of reading: of what varies slowly over a photo, of rows of one, and of the gradient of one
KERNELS_OF_VIEW: dict[type, tuple[Callable, Callable, Callable]] = {
    FullView: (
        expose_kernels.full_grid_kernel,
        expose_kernels.expose_full_kernel,
        back_kernels.expose_full_back_kernel,
    ),
    BinnedView: (
        expose_kernels.binned_setup_kernel,
        expose_kernels.expose_binned_kernel,
        back_kernels.expose_binned_back_kernel,
    ),
    PointView: (
        lambda exposure, view, i: None,
        expose_kernels.expose_point_kernel,
        back_kernels.expose_point_back_kernel,
    ),
}


def fits(exposure: Exposure, view: PanelView) -> np.ndarray:
    """Return for each image whether kernels can follow its view, (B,) bool; see
    `expose_kernels.views_fit`."""
    if isinstance(view, PointView):
        return np.ones(len(exposure.cameras), bool)
    if isinstance(view, FullView):
        return expose_kernels.views_fit(exposure, view)
    fitting = expose_kernels.views_fit(exposure, view.picture)
    if len(view.beats.orders):
        fitting &= expose_kernels.beats_fit(exposure, view.beats)
    return fitting


def compile_show(exposure: Exposure, dtype: torch.dtype) -> None:
    """Compile the kernel that shows pictures of a dtype, by showing one."""
    pictures = torch.zeros(1, 3, *exposure.size, dtype=dtype).numpy()
    expose_kernels.show_kernel(*_buffers(exposure, False), pictures, exposure, False, 0)


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
    setup_kernel, expose_kernel, _ = KERNELS_OF_VIEW[type(view)]
    at_points = isinstance(view, PointView)

    def read(i: int, buffers: tuple[np.ndarray, np.ndarray], each_part: Callable) -> None:
        setup = setup_kernel(exposure, view, i)
        expose_kernels.show_kernel(*buffers, pictures, exposure, at_points, i)

        def read_rows(top: int, bottom: int) -> None:
            span = Span(i, top, bottom)
            expose_kernel(*arrays, buffers[0], exposure, view, setup, span)

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
    setup_kernel, _, back_kernel = KERNELS_OF_VIEW[type(view)]
    at_points = isinstance(view, PointView)

    def fill_grads(first: int, last: int) -> None:
        shown_grad, light_grad = _buffers(exposure, at_points)
        for i in range(first, last):
            setup = setup_kernel(exposure, view, i)
            back_kernel(shown_grad, *read_grads, exposure, view, setup, i)
            given = pictures, exposure, at_points, i
            back_kernels.show_back_kernel(grads, shown_grad, light_grad, *given)

    run_in_parts(fill_grads, len(picture))
    return out


def _buffers(exposure: Exposure, at_points: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return workspace for a picture as the panel shows it, (`expose_kernels.shown_length`,)
    float32, and for its light, (3, H, W) float32."""
    shown = np.empty(expose_kernels.shown_length(exposure, at_points), np.float32)
    return shown, np.empty((3, *exposure.size), np.float32)


def launch_develop(raw: Tensor, saves: bool, development: Development) -> tuple[Tensor, Tensor]:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32,
    and a tensor that `launch_develop_back` takes.

    saves: `launch_develop_back` will be called; else that tensor may be empty.
    """
    arrays = develop_arrays(development)
    n, h = len(raw), arrays.size[0]
    count = n if arrays.filters_detail and saves else 0
    unclipped = torch.empty(count, 3, *arrays.detail.size, dtype=torch.uint8, device="cpu")
    photo, readings = empty(n, 3, *arrays.size), array_of(raw)
    filled = photo.numpy(), unclipped.numpy()

    def fill_photos(first: int, last: int, top: int = 0, bottom: int = h) -> None:
        in_camera = np.zeros(develop_kernels.in_camera_length(arrays), np.float32)
        out = Photos(filled[0], in_camera, filled[1])
        develop_kernels.develop_kernel(out, readings, arrays, first, last, top, bottom)

    whole = n - surplus_images(n, h)
    run_in_parts(fill_photos, whole)
    for i in range(whole, n):
        run_in_shares(functools.partial(fill_photos, i, i + 1), h)
    return photo, unclipped


def launch_develop_back(
    grad: Tensor, raw: Tensor, unclipped: Tensor, development: Development
) -> Tensor:
    """Return the gradient in the readings, from that in the photos and the tensor that
    `launch_develop` saved."""
    out, arrays = empty(*raw.shape), develop_arrays(development)
    raw_grads, photo_grads, readings = out.numpy(), array_of(grad), array_of(raw)

    def fill_grads(first: int, last: int) -> None:
        in_camera = np.empty(develop_kernels.in_camera_length(arrays), np.float32)
        given = in_camera, unclipped.numpy(), readings, arrays, first, last
        develop_kernels.develop_back_kernel(raw_grads, photo_grads, *given)

    run_in_parts(fill_grads, len(raw))
    return out
