"""The sets of kernels, one for each type of device, and why one cannot run here."""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import NamedTuple

ENGINE_VARIABLE = "MOIREAUG_ENGINE"  # the environment variable that may force the reference
OFF_VALUES = ("off", "0", "false", "no")  # its values that do, in capitals or not
ON_VALUES = ("", "on", "1", "true", "yes")
_open_blocks = 0  # `with reference()` blocks, in any thread
_counting = threading.Lock()

NO_JIT_VARIABLE = "NUMBA_DISABLE_JIT"  # numba's own


@contextlib.contextmanager
def reference() -> Iterator[None]:
    """Force the reference within a `with` block, in all threads. `MOIREAUG_ENGINE=off` forces it
    everywhere."""
    global _open_blocks
    with _counting:
        _open_blocks += 1
    try:
        yield
    finally:
        with _counting:
            _open_blocks -= 1


def is_off() -> bool:
    """Return whether the reference is forced.

    Raises:
        ValueError: an environment variable that says neither.
    """
    value = os.environ.get(ENGINE_VARIABLE, "")
    if value.lower() not in (*OFF_VALUES, *ON_VALUES):
        raise ValueError(f"{ENGINE_VARIABLE} must be 'off', or unset; got {value!r}.")
    return bool(_open_blocks) or value.lower() in OFF_VALUES


class Backend(NamedTuple):
    """The kernels for one type of device.

    Args:
        name: the library that compiles them. device_type: one of PyTorch's.
        module: what `kernels` imports. reads_full: whether there are kernels of full readings.
        why_not_compiled: returns why nothing can be compiled, or an empty string; without importing
            the library.
    """

    name: str
    device_type: str
    module: str
    reads_full: bool
    why_not_compiled: Callable[[], str]

    def kernels(self) -> ModuleType:
        """Return the module of the functions on batches, of tensors and records.

        - prepare(), before any of the others is first called
        - fits(exposure, view) -> (B,) bool, whether kernels can follow each image's view
        - launch_expose(picture, saves, exposure, view) -> raw, saved
        - launch_expose_back(grad, picture, saved, exposure, view) -> gradient in the picture
        - launch_develop(raw, saves, development) -> photo, saved
        - launch_develop_back(grad, raw, saved, development) -> gradient in raw

        The gradient's functions take the tensor that the others saved for it, if `saves`. Its
        SUMS_IN_ORDER says whether `launch_expose_back` adds in a fixed order; if not, the reference
        takes its place where PyTorch is told to be deterministic.
        """
        return importlib.import_module(self.module)


@functools.cache
def _why_no_numba() -> str:
    if importlib.util.find_spec("numba") is None:
        return "numba is not installed"
    if _is_jit_disabled():
        return f"{NO_JIT_VARIABLE} is set, and numba compiles nothing"
    return ""


def _is_jit_disabled() -> bool:
    """Return whether numba runs functions as they are, as debuggers and coverage want it; without
    importing numba."""
    config = sys.modules.get("numba.core.config")
    if config is not None:
        return bool(config.DISABLE_JIT)
    try:
        return bool(int(os.environ.get(NO_JIT_VARIABLE, "0")))
    except ValueError:  # numba takes it for 0
        return False


@functools.cache
def _why_no_triton() -> str:
    return "" if importlib.util.find_spec("triton") else "triton is not installed"


BACKENDS = (
    Backend("numba", "cpu", "moireaug.engine.cpu.run", True, _why_no_numba),
    Backend("Triton", "cuda", "moireaug.engine.gpu.run", False, _why_no_triton),
)


def backend_of(device_type: str) -> Backend | None:
    """Return the backend for a type of device, or None."""
    for backend in BACKENDS:
        if backend.device_type == device_type:
            return backend
    return None


def why_no_kernels(device_type: str) -> str:
    """Return why no kernels run on a type of device, or an empty string."""
    if is_off():
        return "the engine is turned off"
    backend = backend_of(device_type)
    return backend.why_not_compiled() if backend else f"there are no kernels for {device_type}"


# torch.compile calls it once, and does not follow it
why_no_kernels._dynamo_marked_constant = True  # type: ignore[attr-defined]
