"""Kernels on batches: tensors in and out, and threads over images."""

from __future__ import annotations

import functools
import logging
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from moireaug.engine.compiling import cold
from moireaug.engine.record import Development, Exposure

MOST_PANEL = 16  # panel pixels for each sensor pixel: what is worth building a panel for
SMALL_PANEL = 2**20


def announce(message: str) -> None:
    """Say something to the user, once before kernels are compiled. Replace it to say it otherwise."""
    logging.getLogger("moireaug").warning(message)


@functools.lru_cache(maxsize=1)
def prepare() -> None:
    """Announce, on a machine's first call, that kernels are compiled."""
    if cold():
        announce("moireaug compiles its CPU kernels, once on this machine; this takes about 20 seconds.")


def each(work: Callable[[int], None], n: int) -> None:
    """Run work(i) for i < n, on as many threads as the caller's torch uses. Nothing outlives the call, so that a
    process may fork."""
    threads = min(torch.get_num_threads(), n)
    if threads < 2:
        for i in range(n):
            work(i)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, range(n)):
            pass


def fits(exposure: Exposure) -> list[bool]:
    """Return for each image whether `expose` follows its view.

    Views near the horizon, and panels of far more pixels than the sensor, are the reference's.
    """
    from moireaug.engine.nodes import fits as kernel
    from moireaug.engine.panel import panel_shape

    prepare()
    e = exposure
    if e.point:
        return [True] * len(e.cameras)
    found = []
    for i, camera in enumerate(e.cameras):
        h, w = panel_shape(e.size, camera.alpha, tuple(e.cell.period), e.cell.taps)
        if h * w > max(MOST_PANEL * len(e.sites.rows) * len(e.sites.cols), SMALL_PANEL):
            found.append(False)
            continue
        found.append(kernel(camera, e.cell, e.coefficients[i], e.widths[i], e.skew[i], e.sites, e.dark))
    return found


def expose(picture: Tensor, exposure: Exposure) -> Tensor:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    from moireaug.engine import panel as panels
    from moireaug.engine.expose import expose as kernel
    from moireaug.engine.nodes import prepare as prepare_nodes
    from moireaug.engine.picture import show as show_picture
    from moireaug.engine.point import expose_point

    prepare()
    e = exposure
    (h, w), period, taps = e.size, e.cell.period, e.cell.taps
    planes, step = len(e.sites.channel), e.sites.step
    raw = torch.empty(len(picture), planes, len(e.sites.rows) // step, len(e.sites.cols) // step)
    pictures, readings = picture.detach().contiguous().numpy(), raw.numpy()

    def light_of(i: int) -> np.ndarray:
        if pictures.dtype == np.float32 and not e.coded and not e.share[i]:
            return pictures[i]
        light = np.empty((3, h, w), np.float32)
        show_picture(light, pictures[i], e.coded, e.share[i])
        return light

    def work_on_points(i: int) -> None:
        expose_point(
            readings[i], light_of(i), e.cameras[i], e.cell, e.point.rectangles, e.point.raster, e.point.lit[i], e.sites,
            e.flicker[i], e.noise, e.seeds[i], e.clips, e.dark,
        )  # fmt: skip

    def work(i: int) -> None:
        camera = e.cameras[i]
        panel = np.empty((3, *panels.panel_shape(e.size, camera.alpha, tuple(period), taps)), np.float32)
        panels.show(panel, light_of(i), camera.alpha, period, taps, e.dark)
        size = (math.ceil(camera.alpha * h), math.ceil(camera.alpha * w))
        nodes = prepare_nodes(camera, e.cell, e.coefficients[i], e.widths[i], e.skew[i], e.sites)
        kernel(readings[i], panel, size, camera, e.cell, nodes, e.sites, e.flicker[i], e.noise, e.seeds[i], e.clips)

    each(work_on_points if e.point else work, len(picture))
    return raw


def _development(photo: np.ndarray, raw: np.ndarray, d: Development, i: int, grad: np.ndarray | None = None) -> None:
    from moireaug.engine import develop as kernels

    settings = (d.mosaic, d.stencil, d.saturates, d.levels, d.gains[i], d.coded, d.brighten[i], d.rows, d.cols)
    if grad is None:
        kernels.develop(photo, raw, *settings)
    else:
        kernels.develop_back(grad, photo, raw, *settings)


class _Develop(torch.autograd.Function):
    """Readings to photos, once differentiable in the readings."""

    @staticmethod
    def forward(ctx, raw: Tensor, d: Development) -> Tensor:
        from moireaug.engine.register import register

        ctx.save_for_backward(raw)
        ctx.development = d
        out = torch.empty(len(raw), 3, *d.size)
        readings, photos = raw.detach().contiguous().numpy(), out.numpy()

        def work(i: int) -> None:
            if d.views is None:
                _development(photos[i], readings[i], d, i)
                return
            photo = np.empty((3, *d.size), np.float32)
            _development(photo, readings[i], d, i)
            register(photos[i], photo, d.views[i], *d.lens[i], False)

        each(work, len(raw))
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None]:
        from moireaug.engine.register import register

        (raw,), d = ctx.saved_tensors, ctx.development
        out = torch.empty(raw.shape)
        readings, grads, results = raw.detach().contiguous().numpy(), grad.contiguous().numpy(), out.numpy()

        def work(i: int) -> None:
            photo = grads[i]
            if d.views is not None:
                photo = np.empty((3, *d.size), np.float32)
                register(grads[i], photo, d.views[i], *d.lens[i], True)
            _development(photo, readings[i], d, i, results[i])

        each(work, len(raw))
        return out, None


def develop(raw: Tensor, development: Development) -> Tensor:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32; once differentiable in
    the readings."""
    prepare()
    return _Develop.apply(raw, development)
