"""The switch between engine and reference, and whether the engine can run at all."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import sys
import threading
from collections.abc import Iterator

ENGINE_VARIABLE = "MOIREAUG_ENGINE"  # the environment variable that may force the reference
OFF_VALUES = ("off", "0", "false", "no")  # its values that do, in capitals or not
ON_VALUES = ("", "on", "1", "true", "yes")
NO_JIT_VARIABLE = "NUMBA_DISABLE_JIT"  # numba's own
_open_blocks = 0  # `with reference()` blocks, in any thread
_counting = threading.Lock()


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


def why_unavailable() -> str:
    """Return why no scene gets the engine, or an empty string."""
    if _open_blocks or _switched_off(os.environ.get(ENGINE_VARIABLE, "")):
        return "the engine is turned off"
    return _without_compiler()


# torch.compile calls it once, and does not follow it
why_unavailable._dynamo_marked_constant = True  # type: ignore[attr-defined]


@functools.cache
def _switched_off(value: str) -> bool:
    """Return whether the environment turns the engine off.

    Raises:
        ValueError: a value that says neither.
    """
    if value.lower() not in (*OFF_VALUES, *ON_VALUES):
        raise ValueError(f"{ENGINE_VARIABLE} must be 'off', or unset; got {value!r}.")
    return value.lower() in OFF_VALUES


@functools.cache
def _without_compiler() -> str:
    """Return why no kernel can be compiled, or an empty string."""
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
