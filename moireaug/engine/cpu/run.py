"""Kernels on batches: tensors in and out."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from moireaug.engine.cpu import ahead, batch, compiling
from moireaug.engine.cpu.records import Photos
from moireaug.engine.cpu.threads import each, each_share, surplus
from moireaug.engine.development_records import Development
from moireaug.engine.exposure_records import Beats, Exposure
from moireaug.numeric import is_batched

SHOWN_VALUES_AT_ONCE = 2**16  # of small panels, which are filled before any is read


def announce(message: str) -> None:
    """Tell the user that kernels are about to be compiled. Replace this function to say it
    elsewhere."""
    logging.getLogger("moireaug").warning(message)


@functools.lru_cache(maxsize=1)
def prepare() -> bool:
    """Announce, on a machine's first call, that kernels are being compiled, and start on those that
    come later; return whether it is the first."""
    cold = compiling.cold()
    if cold:
        announce(
            "moireaug compiles its CPU kernels, once on this machine; this takes up to a minute."
        )
        ahead.start(compiling.folder())
    return cold


def fits(exposure: Exposure, beats: Beats | None) -> np.ndarray:
    """Return for each image whether `expose` can follow its view, (B,) bool; see
    `batch.views_fit`."""
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
    _reader(readings, exposure, beats)(shown, 0, 0, 0, 0)


def compile_show(exposure: Exposure) -> None:
    """Compile the kernel that shows float32 pictures, by showing none."""
    shown, pictures = np.empty((0, 0), np.float32), np.empty((0, 3, 0, 0), np.float32)
    batch.show(shown, _light(exposure), pictures, exposure, 0, 0)


def expose(picture: Tensor, exposure: Exposure, beats: Beats | None) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    prepare()
    sites, n = exposure.sites, len(picture)
    h, w = len(sites.rows) // sites.step, len(sites.cols) // sites.step
    raw = _empty(n, len(sites.channel), h, w)
    pictures = _array(picture)
    if exposure.point:
        each(functools.partial(_expose_points, raw.numpy(), pictures, exposure), n)
        return raw
    whole, read = n - surplus(n, h), _reader(raw.numpy(), exposure, beats)
    each(functools.partial(_expose_images, read, pictures, exposure), whole)
    for i in range(whole, n):
        _expose_shared(read, pictures, exposure, i, h)
    return raw


def _expose_points(
    readings: np.ndarray, pictures: np.ndarray, exposure: Exposure, first: int, last: int
) -> None:
    """Fill the readings from `first` to `last` of a point exposure."""
    batch.expose_points(readings, _light(exposure), pictures, exposure, first, last)


def _reader(readings: np.ndarray, exposure: Exposure, beats: Beats | None) -> Callable[..., None]:
    """Return a function that fills rows of some readings, full or binned, from what is shown."""

    def read(shown: np.ndarray, first: int, last: int, top: int, bottom: int) -> None:
        if beats is None:
            batch.expose(readings, shown, exposure, first, last, top, bottom)
        else:
            batch.expose_binned(readings, shown, exposure, beats, first, last, top, bottom)

    return read


def _expose_images(
    read: Callable[..., None], pictures: np.ndarray, exposure: Exposure, first: int, last: int
) -> None:
    """Fill the readings from `first` to `last`: show some pictures, then read them."""
    size, light = batch.panel_size(exposure), _light(exposure)
    rows = len(exposure.sites.rows) // exposure.sites.step
    count = max(1, SHOWN_VALUES_AT_ONCE // size)
    shown = np.empty((count, size), np.float32)
    for start in range(first, last, count):
        end = min(start + count, last)
        batch.show(shown, light, pictures, exposure, start, end)
        read(shown, start, end, 0, rows)


def _expose_shared(
    read: Callable[..., None], pictures: np.ndarray, exposure: Exposure, i: int, rows: int
) -> None:
    """Fill reading i: all threads share its rows."""
    shown = np.empty((1, batch.panel_size(exposure)), np.float32)
    batch.show(shown, _light(exposure), pictures, exposure, i, i + 1)
    each_share(functools.partial(read, shown, i, i + 1), rows)


def _light(exposure: Exposure) -> np.ndarray:
    """Return workspace for a picture's light, (3, H, W) float32."""
    return np.empty((3, *exposure.size), np.float32)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


def _empty(*shape: int) -> Tensor:
    """Return an uninitialised tensor, float32. NumPy asks for huge pages where it is large; with
    small ones a large photo takes a fifth longer."""
    return torch.from_numpy(np.empty(shape, np.float32))


class _Develop(torch.autograd.Function):
    """Readings to photos, differentiable in the readings."""

    @staticmethod
    def forward(ctx, raw: Tensor, d: Development, reference: Callable[[Tensor], Tensor]) -> Tensor:
        n, h = len(raw), d.size[0]
        count = n if d.finishes and ctx.needs_input_grad[0] else 0
        unclipped = torch.empty(count, 3, *d.detail.size, dtype=torch.uint8, device="cpu")
        ctx.save_for_backward(raw, unclipped)
        ctx.development, ctx.reference = d, reference
        photo = _empty(n, 3, *d.size)
        work = functools.partial(_develop, photo.numpy(), unclipped.numpy(), _array(raw), d)
        whole = n - surplus(n, h)
        each(functools.partial(work, top=0, bottom=h), whole)
        for i in range(whole, n):
            each_share(functools.partial(work, i, i + 1), h)
        return photo

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None, None]:
        (raw, unclipped), d = ctx.saved_tensors, ctx.development
        twice = torch.is_grad_enabled()  # the gradient itself is to be differentiated
        if twice or is_batched(grad):
            # autocast may be on where backward is called
            with torch.enable_grad(), torch.autocast("cpu", enabled=False):
                photo = ctx.reference(raw)
                return torch.autograd.grad(photo, raw, grad, create_graph=twice)[0], None, None
        out = _empty(*raw.shape)
        arrays = out.numpy(), _array(grad), unclipped.numpy(), _array(raw)
        each(functools.partial(_develop_back, *arrays, d), len(raw))
        return out, None, None


def _develop(
    photos: np.ndarray,
    unclipped: np.ndarray,
    readings: np.ndarray,
    d: Development,
    first: int,
    last: int,
    top: int,
    bottom: int,
) -> None:
    """Fill rows `top` to `bottom` of the photos from `first` to `last`; see `batch.develop`."""
    out = Photos(photos, np.zeros(batch.photo_size(d), np.float32), unclipped)
    batch.develop(out, readings, d, first, last, top, bottom)


def _develop_back(
    raw_grads: np.ndarray,
    photo_grads: np.ndarray,
    unclipped: np.ndarray,
    readings: np.ndarray,
    d: Development,
    first: int,
    last: int,
) -> None:
    """Fill the gradients from `first` to `last` in the readings; see `batch.develop_back`."""
    in_camera = np.empty(batch.photo_size(d), np.float32)
    batch.develop_back(raw_grads, photo_grads, in_camera, unclipped, readings, d, first, last)


def develop(raw: Tensor, development: Development, reference: Callable[[Tensor], Tensor]) -> Tensor:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32;
    differentiable in the readings.

    reference: does the same in PyTorch, for derivatives of the gradient.
    """
    prepare()
    return _Develop.apply(raw, development, reference)
