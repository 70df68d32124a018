"""Kernels on batches: tensors in and out."""

from __future__ import annotations

import functools
import logging

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from moireaug.engine import ahead, compiling
from moireaug.engine.development_records import Development
from moireaug.engine.exposure_records import Exposure
from moireaug.engine.threads import each, each_share, surplus

HELD = 2**16  # values of small panels that are filled before any is read


def announce(message: str) -> None:
    """Tell the user that kernels are about to be compiled. Replace this function to say it
    elsewhere."""
    logging.getLogger("moireaug").warning(message)


@functools.lru_cache(maxsize=1)
def prepare() -> None:
    """Announce, on a machine's first call, that kernels are being compiled, and start on those that
    come later."""
    if compiling.cold():
        announce(
            "moireaug compiles its CPU kernels, once on this machine; this takes up to a minute."
        )
        ahead.start(compiling.folder())


def fits(exposure: Exposure) -> np.ndarray:
    """Return for each image whether `expose` can follow its view, (B,) bool; see `batch.fits`."""
    from moireaug.engine import batch

    prepare()
    if exposure.point:
        return np.ones(len(exposure.cameras), bool)
    return batch.fits(exposure)


def expose(picture: Tensor, exposure: Exposure) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    from moireaug.engine import batch

    prepare()
    sites, n = exposure.sites, len(picture)
    planes, step = len(sites.channel), sites.step
    h, w = len(sites.rows) // step, len(sites.cols) // step
    raw = _empty(n, planes, h, w)
    pictures, readings = picture.detach().contiguous().numpy(), raw.numpy()
    size = batch.panel_size(exposure)
    held = max(1, HELD // size)

    def light() -> np.ndarray:
        return np.empty((3, *exposure.size), np.float32)

    def points(first: int, last: int) -> None:
        batch.expose_points(readings, light(), pictures, exposure, first, last)

    def images(first: int, last: int) -> None:
        shown, space = np.empty((held, size), np.float32), light()
        for start in range(first, last, held):
            end = min(start + held, last)
            batch.show(shown, space, pictures, exposure, start, end)
            batch.expose(readings, shown, exposure, start, end, 0, h)

    if exposure.point:
        each(points, n)
        return raw
    whole = n - surplus(n, h)
    each(images, whole)
    for i in range(whole, n):
        shown = np.empty((1, size), np.float32)
        batch.show(shown, light(), pictures, exposure, i, i + 1)
        each_share(functools.partial(batch.expose, readings, shown, exposure, i, i + 1), h)
    return raw


def _empty(*shape: int) -> Tensor:
    """Return an uninitialised tensor, float32. NumPy asks for huge pages where it is large: small
    ones cost a fifth of the time that a large photo takes."""
    return torch.from_numpy(np.empty(shape, np.float32))


class _Develop(torch.autograd.Function):
    """Readings to photos, once differentiable in the readings."""

    @staticmethod
    def forward(ctx, raw: Tensor, d: Development) -> Tensor:
        from moireaug.engine import batch

        noted = len(raw) if d.finishes and ctx.needs_input_grad[0] else 0
        inside = torch.empty(noted, 3, *d.detail.size, dtype=torch.uint8)
        ctx.save_for_backward(raw, inside)
        ctx.development = d
        out = _empty(len(raw), 3, *d.size)
        readings, photos, notes = raw.detach().contiguous().numpy(), out.numpy(), inside.numpy()
        n, h = len(raw), d.size[0]

        def kernel(first: int, last: int, top: int, bottom: int) -> None:
            taken = np.zeros(size, np.float32)
            batch.develop(photos, taken, notes, readings, d, first, last, top, bottom)

        whole, size = n - surplus(n, h), batch.photo_size(d)
        each(lambda first, last: kernel(first, last, 0, h), whole)
        for i in range(whole, n):
            each_share(functools.partial(kernel, i, i + 1), h)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None]:
        from moireaug.engine import batch

        (raw, inside), d = ctx.saved_tensors, ctx.development
        out = _empty(*raw.shape)
        readings, notes = raw.detach().contiguous().numpy(), inside.numpy()
        grads, results = grad.contiguous().numpy(), out.numpy()

        def kernel(first: int, last: int) -> None:
            taken = np.empty(size, np.float32)
            batch.develop_back(results, grads, taken, notes, readings, d, first, last)

        size = batch.photo_size(d)
        each(kernel, len(raw))
        return out, None


def develop(raw: Tensor, development: Development) -> Tensor:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32;
    once differentiable in the readings."""
    prepare()
    return _Develop.apply(raw, development)
