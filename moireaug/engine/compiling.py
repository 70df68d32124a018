"""Compilation: what is compiled into what, and where the result is kept."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
from pathlib import Path

import llvmlite
import numba
from filelock import FileLock
from numba import njit

# divisions by zero give infinity and need no branch
loop = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
# a loop that neither makes nor returns an array: its callers hold all that it works on, so it need
# not count references, which took a quarter of a kernel's time
inner = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False)


@functools.lru_cache(maxsize=1)
def _folder() -> str | None:
    """Return where compiled kernels are kept, by all of the engine's sources and versions; None
    where nowhere."""
    here = Path(__file__).parent
    sources = [*sorted(here.glob("*.py")), here.parent / "effects" / "random_numbers.py"]
    text = b"".join(source.read_bytes() for source in sources)
    text += f"{numba.__version__} {llvmlite.__version__}".encode()
    name = hashlib.sha256(text).hexdigest()[:16]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "moireaug"
    for place in (numba.config.CACHE_DIR, here / "__pycache__", home):
        if not place:
            continue
        folder = Path(place) / f"moireaug-{name}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return None


def cold() -> bool:
    """Return whether this machine has not compiled these kernels yet."""
    folder = _folder()
    return folder is None or not any(Path(folder).rglob("*.nbi"))


def kernel(function):
    """Compile a function that a thread calls for a whole image, without the GIL and once per
    machine: of processes that start together, such as workers, one compiles and the others wait.

    Numba's own cache looks at the function's file alone, and would miss a change in what the
    function calls.
    """
    folder, before = _folder(), numba.config.CACHE_DIR
    if folder is None:
        return njit(error_model="numpy", nogil=True)(function)
    numba.config.CACHE_DIR = folder
    try:
        compiled = njit(error_model="numpy", nogil=True, cache=True)(function)
    finally:
        numba.config.CACHE_DIR = before
    compiled.compile = _locked(compiled.compile, Path(folder) / f"{function.__name__}.lock")
    return compiled


def _locked(compile_, path):
    """Return a dispatcher's `compile` that one process at a time enters: the next one finds in
    numba's cache what the first has kept there."""

    def locked(signature):
        with contextlib.ExitStack() as held:
            with contextlib.suppress(OSError):  # a disk without locks
                held.enter_context(FileLock(path, fallback_to_soft=False))
            return compile_(signature)

    return locked


@inner
def fill(out, value):
    """Fill a row; numba compiles an assignment to a slice for seconds, for its error messages."""
    for i in range(len(out)):
        out[i] = value


@inner
def copy(out, row):
    """Copy what both rows have room for."""
    for i in range(min(len(out), len(row))):
        out[i] = row[i]
