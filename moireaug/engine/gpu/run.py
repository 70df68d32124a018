"""The GPU's kernels on batches of binned readings; see `engine.backends.Backend.kernels`.
Nothing is saved for a gradient, which recomputes what it needs."""

from __future__ import annotations

import contextlib

import torch
from torch import Tensor

from moireaug.engine.gpu import binned
from moireaug.engine.gpu import develop as developing
from moireaug.engine.gpu.binned import fits as fits
from moireaug.engine.lower.development_records import Development
from moireaug.engine.lower.exposure_records import BinnedView, Exposure

SUMS_IN_ORDER = False


def prepare() -> None:
    """Do nothing: Triton compiles within seconds."""


def launch_expose(
    picture: Tensor, saves: bool, exposure: Exposure, view: BinnedView
) -> tuple[Tensor, Tensor]:
    """Return the readings (B, planes, h, w) float32 of pictures (B, 3, H, W), float32 or uint8."""
    with _device_of(picture):
        raw = binned.expose(picture, exposure, view)
    return raw, raw.new_empty(0)


def launch_expose_back(
    grad: Tensor, picture: Tensor, saved: Tensor, exposure: Exposure, view: BinnedView
) -> Tensor:
    """Return the gradient in pictures, from that in their readings. Sums are not in a fixed
    order."""
    with _device_of(picture):
        return binned.expose_back(grad, picture, exposure, view)


def launch_develop(raw: Tensor, saves: bool, development: Development) -> tuple[Tensor, Tensor]:
    """Return the photos (B, 3, H, W) float32, sRGB codes, of readings (B, planes, h, w) float32."""
    with _device_of(raw):
        return developing.develop(raw, development), raw.new_empty(0)


def launch_develop_back(
    grad: Tensor, raw: Tensor, saved: Tensor, development: Development
) -> Tensor:
    """Return the gradient in the readings, from that in the photos."""
    with _device_of(raw):
        return developing.develop_back(grad, raw, development)


def _device_of(values: Tensor) -> contextlib.AbstractContextManager[object]:
    """Make the GPU that holds some values the current one, on which Triton launches."""
    if values.device.type == "cpu":  # Triton's interpreter
        return contextlib.nullcontext()
    return torch.accelerator.device_index(values.device.index)
