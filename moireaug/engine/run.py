"""Kernels on batches: tensors in and out."""

from __future__ import annotations

import functools
import logging

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from moireaug.engine.compiling import cold
from moireaug.engine.record import Development, Exposure
from moireaug.engine.threads import each


def announce(message: str) -> None:
    """Tell the user that kernels are about to be compiled. Replace this function to say it
    elsewhere."""
    logging.getLogger("moireaug").warning(message)


@functools.lru_cache(maxsize=1)
def prepare() -> None:
    """Announce, on a machine's first call, that kernels are being compiled."""
    if cold():
        announce(
            "moireaug compiles its CPU kernels, once on this machine; this takes up to a minute."
        )


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
    sites = exposure.sites
    planes, step = len(sites.channel), sites.step
    raw = torch.empty(len(picture), planes, len(sites.rows) // step, len(sites.cols) // step)
    pictures, readings = picture.detach().contiguous().numpy(), raw.numpy()
    none = pictures[:0]
    if pictures.dtype == np.uint8:
        floats, codes = none.astype(np.float32), pictures
    else:
        floats, codes = pictures, none.astype(np.uint8)
    kernel = batch.expose_points if exposure.point else batch.expose
    each(lambda first, last: kernel(readings, floats, codes, exposure, first, last), len(picture))
    return raw


class _Develop(torch.autograd.Function):
    """Readings to photos, once differentiable in the readings."""

    @staticmethod
    def forward(ctx, raw: Tensor, d: Development) -> Tensor:
        from moireaug.engine import batch

        noted = len(raw) if d.finishes and ctx.needs_input_grad[0] else 0
        inside = torch.empty(noted, 3, *d.detail.size, dtype=torch.uint8)
        ctx.save_for_backward(raw, inside)
        ctx.development = d
        out = torch.empty(len(raw), 3, *d.size)
        readings, photos, notes = raw.detach().contiguous().numpy(), out.numpy(), inside.numpy()
        each(lambda first, last: batch.develop(photos, notes, readings, d, first, last), len(raw))
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None]:
        from moireaug.engine import batch

        (raw, inside), d = ctx.saved_tensors, ctx.development
        out = torch.empty(raw.shape)
        readings, notes = raw.detach().contiguous().numpy(), inside.numpy()
        grads, results = grad.contiguous().numpy(), out.numpy()
        each(
            lambda first, last: batch.develop_back(results, grads, notes, readings, d, first, last),
            len(raw),
        )
        return out, None


def develop(raw: Tensor, development: Development) -> Tensor:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32;
    once differentiable in the readings."""
    prepare()
    return _Develop.apply(raw, development)
