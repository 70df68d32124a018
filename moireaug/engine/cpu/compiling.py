"""Compilation: what is compiled into what, and where the result is cached."""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import os
import shutil
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import llvmlite
import numba
from filelock import FileLock
from numba import njit

KERNELS = Path(__file__).parent
MAX_UNUSED_SECONDS = 30 * 24 * 3600  # of a folder of kernels
PACKAGE = KERNELS.parents[1]
# files outside this folder whose numbers and records are compiled into kernels
CONSTANT_SOURCES = (
    "effects/binned_statistics.py",
    "effects/detail.py",
    "effects/random_numbers.py",
    "effects/sensor.py",
    "engine/jacobian.py",
    "engine/lower/budget.py",
    "engine/lower/development_records.py",
    "engine/lower/exposure_records.py",
    "exposure/footprint.py",
    "exposure/displayed.py",
    "geometry/distortion.py",
    "geometry/frame.py",
    "geometry/grids.py",
    "scene/lens.py",
    "scene/record.py",
)
# a product and a sum may be rounded together
FAST_MATH = {"contract"}
# divisions by zero give infinity and need no branch
loop = njit(error_model="numpy", fastmath=FAST_MATH, no_cpython_wrapper=True, no_cfunc_wrapper=True)
# for what only calls loops: a part of its caller before types are inferred, which saves a sixth of
# the compilation of all kernels
part = njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
# for loops that neither allocate nor return arrays: their callers hold all that they work on, so
# they need not count references, which took a quarter of a kernel's time
_inner = functools.partial(
    njit, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False
)
inner = _inner(fastmath=FAST_MATH)
# the same for what must round as PyTorch does; without `fastmath`, numba takes the caller's
exact = _inner(fastmath=False)
# the same for what a single function calls for each row: passing hundreds of numbers on takes a
# twentieth of its time
inlined = _inner(fastmath=FAST_MATH, forceinline=True)


@functools.lru_cache(maxsize=1)
def folder() -> str | None:
    """Return the folder of compiled kernels, named by a hash of the sources and of numba's and
    llvmlite's versions; None if no place is writable."""
    sources = sorted(KERNELS.rglob("*.py")) + [PACKAGE / name for name in CONSTANT_SOURCES]
    text = b"".join(source.read_bytes() for source in sources)
    text += f"{numba.__version__} {llvmlite.__version__}".encode()
    name = hashlib.sha256(text).hexdigest()[:16]
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for parent in (numba.config.CACHE_DIR, KERNELS / "__pycache__", f"{home}/moireaug"):
        if not parent:
            continue
        try:
            path = Path(parent).expanduser() / f"moireaug-{name}"
            is_new = not path.is_dir()
            path.mkdir(parents=True, exist_ok=True)
            path.touch()  # the time of its last use
        except (OSError, RuntimeError):  # not writable, or a user without a home
            continue
        if os.access(path, os.W_OK):
            if is_new:
                _remove_unused(path.parent)
            return str(path)
    return None


def _remove_unused(parent: Path) -> None:
    """Remove the folders of other sources' kernels that nobody has used for long."""
    earliest = time.time() - MAX_UNUSED_SECONDS
    # a cache folder may be one for everything, such as /tmp: only names that `folder` gives
    for path in parent.glob("moireaug-" + "[0-9a-f]" * 16):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < earliest:
                shutil.rmtree(path, ignore_errors=True)


def is_cold(module: str = "") -> bool:
    """Return whether the kernels of a module, or all, are yet to be compiled on this machine."""
    path = folder()
    return path is None or not any(Path(path).rglob(f"{module}*.nbi"))


def kernel(function):
    """Compile a function that Python calls, from any thread, without the GIL and once per machine:
    of processes that start together, such as workers, one compiles and the others wait.

    Numba's own cache checks only the function's own file, and would miss a change in what the
    function calls.
    """
    path, before = folder(), numba.config.CACHE_DIR
    if path is None:
        return njit(error_model="numpy", nogil=True)(function)
    numba.config.CACHE_DIR = path
    try:
        compiled = njit(error_model="numpy", nogil=True, cache=True)(function)
    finally:
        numba.config.CACHE_DIR = before
    compiled.compile = _locked(compiled.compile, Path(path) / f"{function.__name__}.lock")
    return compiled


def _locked(compile_, path):
    """Return a dispatcher's `compile` behind a file lock: one process compiles, and the next one
    finds the result in numba's cache."""

    def locked(signature):
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(OSError):  # a file system without locks
                stack.enter_context(FileLock(path, fallback_to_soft=False))
            stack.enter_context(_without_garbage_collection())
            return _in_own_thread(functools.partial(compile_, signature))

    return locked


def _in_own_thread(task):
    """Run a task in a thread of its own, and return what it returns. A compilation takes a sixth
    longer in the main thread, whose memory goes back to the system again and again."""
    done: Future = Future()

    def work():
        try:
            done.set_result(task())
        except BaseException as error:
            done.set_exception(error)

    # nobody who interrupts a program waits for its kernels
    threading.Thread(target=work, daemon=True).start()
    return done.result()


@contextlib.contextmanager
def _without_garbage_collection():
    """Pause garbage collection, which takes a sixth of a compilation: torch has many objects."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@inner
def fill(out, value):
    """Fill a row; numba takes seconds to compile a slice assignment, for its error messages."""
    for i in range(len(out)):
        out[i] = value


@inner
def copy(out, row):
    """Copy as many values as both rows have room for."""
    for i in range(min(len(out), len(row))):
        out[i] = row[i]
