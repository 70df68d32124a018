"""Threads over the images of a batch, or the rows of an image: PyTorch's where they are OpenMP's,
else Python's.

OpenMP's threads wait for work by spinning. Threads of our own would share the cores with them after
each of PyTorch's operations, which costs a fifth of a capture's time.
"""

from __future__ import annotations

import ctypes
import functools
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch

# OpenMP's threads do not survive a fork, and whatever waits for them hangs: only the process that
# imported this module uses them
IMPORTING_PROCESS_ID = os.getpid()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))

PARTS_PER_THREAD = 4  # of a batch, one after another, as images take different times
MIN_ROWS_PER_THREAD = 32  # of an image: fewer are not worth a thread
TASK_TYPE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


def is_forked() -> bool:
    """Return whether this process was forked from the one that imported this module."""
    return os.getpid() != IMPORTING_PROCESS_ID


def surplus_images(n: int, rows: int) -> int:
    """Return how many of n images are left when every thread has had equally many: too few to keep
    all threads busy, so that the threads share each one's rows. 0 if its rows are too few for
    that."""
    threads = torch.get_num_threads()
    left = n % threads
    return left if left < min(threads, rows // MIN_ROWS_PER_THREAD) else 0


def run_in_parts(work: Callable[[int, int], None], n: int) -> None:
    """Run work(first, last) on parts of range(n), on as many threads as the caller's torch uses.

    Raises whatever `work` raises first.
    """
    _run(work, n, max(1, n // (PARTS_PER_THREAD * torch.get_num_threads())))


def run_in_shares(work: Callable[[int, int], None], rows: int) -> None:
    """Do the same as `run_in_parts`, with one part per thread: for an image's rows, which take
    equally long and of which each part adds some work."""
    _run(work, rows, max(MIN_ROWS_PER_THREAD, math.ceil(rows / torch.get_num_threads())))


def _run(work: Callable[[int, int], None], n: int, part: int) -> None:
    threads = min(torch.get_num_threads(), math.ceil(n / part))
    if threads < 2:
        work(0, n)
        return
    firsts = iter(range(0, n, part))
    failed: list[BaseException] = []

    def take_parts() -> None:
        try:
            for first in firsts:
                work(first, min(first + part, n))
        except BaseException as error:
            failed.append(error)

    run_on_threads(take_parts, threads)
    if failed:
        raise failed[0]


def run_on_threads(task: Callable[[], None], threads: int) -> None:
    """Call a task, which must not raise, on several threads at once, and wait for all of them."""
    parallel = _openmp()
    if parallel is None or is_forked():
        with ThreadPoolExecutor(threads) as pool:
            for _ in range(threads):
                pool.submit(task)
        return
    parallel(TASK_TYPE(lambda _: task()), None, threads, 0)


@functools.cache
def _openmp() -> Callable | None:
    """Return GOMP_parallel of the OpenMP runtime that PyTorch is linked with; libgomp, and LLVM's
    and Intel's runtimes on Linux, have it. None where there is no such function."""
    try:
        parallel = ctypes.CDLL(torch._C.__file__).GOMP_parallel
    except (OSError, AttributeError):
        return None
    parallel.argtypes = [TASK_TYPE, ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint]
    parallel.restype = None
    return parallel
