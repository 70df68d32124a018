"""Kernels that cannot be imported, and those of a GPU that fail or differ from the reference on the
first batch that a user gives them, are left alone. They were proved equal on a CPU; drivers and
cards are many."""

from __future__ import annotations

import functools
import logging
from types import ModuleType

import torch
from torch import Tensor

from moireaug.common.numeric import as_float
from moireaug.engine.backends import Backend
from moireaug.engine.stage import KernelStage, Stage

MAX_RMS = 1e-3  # of photos and readings, in [0, 1]; kernels and reference differ by 1e-4 at most
_agreements: dict[tuple[str, torch.dtype, torch.device, bool], bool] = {}


@functools.cache
def kernels_of(backend: Backend) -> ModuleType | None:
    """Return the module of a backend's kernels, prepared, or None if it cannot be imported, as
    where the library that compiles them does not go with an installed NumPy or driver."""
    try:
        kernels = backend.kernels()
    except (ImportError, OSError) as error:
        _report(f"{backend.name} kernels cannot be imported ({_summary(error)})")
        return None
    kernels.prepare()
    return kernels


def matches_reference(stage: KernelStage, values: Tensor, *, back: bool) -> bool:
    """Return whether a stage's kernels give the reference's results on the device of `values`, and
    a gradient if one is asked for. Tried once a process, device, dtype and variant of the kernels,
    and again when a gradient is first asked for, and again after every batch that was too large to
    compare.

    Args:
        values: pictures or readings, (B, C, H, W).
        back: a gradient in the values is asked for.
    """
    if values.device.type == "cpu":
        return True
    variant = stage.variant()
    key = variant, values.dtype, values.device, back
    if key not in _agreements:
        failure = failure_of(stage, values.detach(), back=back)
        if failure is None:
            return True
        _agreements[key] = not failure
        if failure:
            _report(f"GPU kernels ({variant}) {failure} on {values.device}, of {values.dtype}")
    return _agreements[key]


@torch.no_grad()
def failure_of(stage: Stage, values: Tensor, *, back: bool) -> str | None:
    """Return how a stage's kernels fail, an empty string if they do not, or None if a batch is too
    large for the reference, which takes more memory.

    back: also call those of the gradient. Its numbers are not compared: the reference's takes many
    times the memory of the batch.
    """
    try:
        results, saved = stage.forward(values, back)
        gradient = stage.backward(results, values, saved) if back else None
        finite = gradient is None or bool(gradient.isfinite().all())
    except torch.OutOfMemoryError:
        raise  # the batch's fault, not the kernels'
    except Exception as error:  # of a compiler, a driver or a launch
        return f"do not run ({_summary(error)})"
    try:
        expected = stage.reference(as_float(values))
    except torch.OutOfMemoryError:
        return None
    difference = (results - expected).square().mean().sqrt().item()
    if not difference <= MAX_RMS:
        return f"differ from the reference by {difference:.1g} RMS"
    return "" if finite else "give a gradient that is not finite"


def _summary(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


def _report(failure: str) -> None:
    logging.getLogger("moireaug").warning(
        f"moireaug's {failure}: PyTorch computes photos instead, which takes longer. Please report "
        "it."
    )
