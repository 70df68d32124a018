"""The switch between engine and reference."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Iterator

ENGINE_VARIABLE = "MOIREAUG_ENGINE"  # the environment variable that may force the reference
OFF_VALUES = ("off", "0", "false", "no")  # its values that do, in capitals or not
ON_VALUES = ("", "on", "1", "true", "yes")
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


def is_off() -> bool:
    """Return whether the reference is forced."""
    return bool(_open_blocks) or _switched_off(os.environ.get(ENGINE_VARIABLE, ""))


@functools.cache
def _switched_off(value: str) -> bool:
    """Return whether the environment turns the engine off.

    Raises:
        ValueError: a value that says neither.
    """
    if value.lower() not in (*OFF_VALUES, *ON_VALUES):
        raise ValueError(f"{ENGINE_VARIABLE} must be 'off', or unset; got {value!r}.")
    return value.lower() in OFF_VALUES
