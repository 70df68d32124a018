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
from filelock import FileLock, Timeout
from numba import njit

from moireaug.engine.cpu.kernel_cache import KernelCache, warn_once

KERNELS = Path(__file__).parent
MAX_UNUSED_SECONDS = 30 * 24 * 3600  # of a folder of kernels
SILENT_SECONDS = 2.0  # for which another process's compilation is waited for without a word
MAX_WAIT_SECONDS = 600.0  # for one kernel, many times as long as it takes
WAITING_MESSAGE = (
    "moireaug waits for another process, which compiles its CPU kernels, once on this machine; "
    "this takes one to several minutes."
)
PACKAGE = KERNELS.parents[1]
FORMULAS = PACKAGE / "common" / "physics"
# files outside these folders whose numbers and records are compiled into kernels
CONSTANT_SOURCES = (
    "camera/effects/detail.py",
    "camera/effects/random_numbers.py",
    "camera/effects/sensor.py",
    "engine/lower/budget.py",
    "engine/lower/development_records.py",
    "engine/lower/exposure_records.py",
    "camera/exposure/footprint.py",
    "camera/exposure/screen.py",
    "scene/record.py",
)
# a product and a sum may be rounded together
FAST_MATH = {"contract"}
# for functions that other compiled ones call; divisions by zero give infinity and need no branch
jit = njit(error_model="numpy", fastmath=FAST_MATH, no_cpython_wrapper=True, no_cfunc_wrapper=True)
# for what only calls compiled functions: put into its caller before types are inferred, which saves
# a sixth of the compilation of all kernels
jit_inlined = njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
# for loops that work in place, and neither allocate nor return arrays: their callers hold all that
# they work on, so they need not count references, which took a quarter of a kernel's time
_jit_in_place = functools.partial(
    njit, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False
)
jit_in_place = _jit_in_place(fastmath=FAST_MATH)
# the same for what must round as PyTorch does; without `fastmath`, numba takes the caller's
jit_in_place_exact = _jit_in_place(fastmath=False)
# the same, put into its caller by LLVM, for what a single function calls for each row: passing
# hundreds of numbers on takes a twentieth of its time
jit_in_place_inlined = _jit_in_place(fastmath=FAST_MATH, forceinline=True)


def _folder_name() -> str:
    """Return the name of a folder of kernels, of a hash of the sources and of numba's and
    llvmlite's versions."""
    sources = sorted([*KERNELS.rglob("*.py"), *FORMULAS.glob("*.py")])
    sources += [PACKAGE / name for name in CONSTANT_SOURCES]
    text = b"".join(source.read_bytes() for source in sources)
    text += f"{numba.__version__} {llvmlite.__version__}".encode()
    return f"moireaug-{hashlib.sha256(text).hexdigest()[:16]}"


def _places() -> list[Path]:
    """Return where a folder of kernels may be, the best place first."""
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    places = []
    for parent in (numba.config.CACHE_DIR, KERNELS / "__pycache__", f"{home}/moireaug"):
        if parent:
            with contextlib.suppress(RuntimeError):  # a user without a home
                places.append(Path(parent).expanduser() / _folder_name())
    return places


@functools.lru_cache(maxsize=1)
def folder() -> str | None:
    """Return the folder that compiled kernels are written to; None if no place is writable."""
    for path in _places():
        try:
            is_new = not path.is_dir()
            path.mkdir(parents=True, exist_ok=True)
            path.touch()  # the time of its last use
        except OSError:
            continue
        if os.access(path, os.W_OK):
            if is_new:
                _remove_unused(path.parent)
            return str(path)
    return None


@functools.lru_cache(maxsize=1)
def other_folders() -> tuple[str, ...]:
    """Return further folders of kernels, to be read: such as one that came with a container's
    image, and cannot be written to."""
    others = []
    for path in _places():
        with contextlib.suppress(OSError):
            if str(path) != folder() and any(path.rglob("*.nbi")):
                others.append(str(path))
    return tuple(others)


def _remove_unused(parent: Path) -> None:
    """Remove the folders of other sources' kernels that nobody has used for long."""
    earliest = time.time() - MAX_UNUSED_SECONDS
    # a cache folder may be one for everything, such as /tmp: only names that `folder` gives
    for path in parent.glob("moireaug-" + "[0-9a-f]" * 16):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < earliest:
                shutil.rmtree(path, ignore_errors=True)


def is_cold() -> bool:
    """Return whether all kernels are yet to be compiled on this machine."""
    path = folder()
    return not other_folders() and (path is None or not any(Path(path).rglob("*.nbi")))


def kernel(function):
    """Compile a function that Python calls, from any thread, without the GIL and once per machine:
    of processes that start together, such as workers, one compiles and the others wait.

    Numba's own cache checks only the function's own file, and would miss a change in what the
    function calls.
    """
    compiled = njit(error_model="numpy", nogil=True)(function)
    places = [path for path in (folder(), *other_folders()) if path is not None]
    if places:
        compiled._cache = KernelCache(function, places[0], places[1:])
        compiled.compile = _locked(compiled, Path(places[0], f"{function.__name__}.lock"))
    return compiled


def _locked(dispatcher, path):
    """Return a dispatcher's `compile` behind a file lock: one process compiles, and the next one
    finds the result in the cache, unless there is none. What is kept already waits for nobody."""
    compile_, cache = dispatcher.compile, dispatcher._cache

    def locked(signature):
        with contextlib.ExitStack() as stack:
            if not (KernelCache.is_full or cache.is_kept(signature, dispatcher.targetctx)):
                _wait_for(stack, FileLock(path, fallback_to_soft=False))
            stack.enter_context(_without_garbage_collection())
            return _in_own_thread(functools.partial(compile_, signature))

    return locked


def _wait_for(stack, lock):
    """Take a lock for as long as a stack is open; say so if another process has it, and if it never
    gives it back, do without."""
    for seconds, message in ((SILENT_SECONDS, WAITING_MESSAGE), (MAX_WAIT_SECONDS, "")):
        try:
            lock.acquire(timeout=seconds)
        except Timeout:
            if message:
                warn_once(message)
        except OSError:  # a file system without locks
            return
        else:
            stack.callback(lock.release)
            return


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


@jit_in_place
def fill(out, value):
    """Fill a row; numba takes seconds to compile a slice assignment, for its error messages."""
    for i in range(len(out)):
        out[i] = value


@jit_in_place
def copy(out, row):
    """Copy as many values as both rows have room for."""
    for i in range(min(len(out), len(row))):
        out[i] = row[i]
