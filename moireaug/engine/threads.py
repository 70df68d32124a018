"""Threads over the images of a batch: PyTorch's own where it has OpenMP's, else Python's.

OpenMP's threads wait for work by spinning. Threads of our own would share the cores with them after
each of PyTorch's operations, which costs a fifth of a capture's time.
"""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch

PARTS = 4  # of a batch per thread, one after another, as images take different times
TASK = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
_parent = os.getpid()


def each(work: Callable[[int, int], None], n: int) -> None:
    """Run work(first, last) on parts of range(n), on as many threads as the caller's torch uses.

    Raises whatever `work` raises first.
    """
    threads = min(torch.get_num_threads(), n)
    if threads < 2:
        work(0, n)
        return
    part = max(1, n // (PARTS * threads))
    firsts = iter(range(0, n, part))
    failed: list[BaseException] = []

    def take_parts() -> None:
        try:
            for first in firsts:
                work(first, min(first + part, n))
        except BaseException as error:
            failed.append(error)

    together(take_parts, threads)
    if failed:
        raise failed[0]


def together(task: Callable[[], None], threads: int) -> None:
    """Call a task, which must not raise, on several threads at once, and wait for all of them."""
    parallel = _openmp()
    # OpenMP's threads do not survive a fork
    if parallel is None or os.getpid() != _parent:
        with ThreadPoolExecutor(threads) as pool:
            for _ in range(threads):
                pool.submit(task)
        return
    parallel(TASK(lambda _: task()), None, threads, 0)


@functools.cache
def _openmp() -> Callable | None:
    """Return GOMP_parallel of the OpenMP runtime that PyTorch is linked with; libgomp, and LLVM's
    and Intel's runtimes on Linux, have it. None where there is no such function."""
    try:
        parallel = ctypes.CDLL(torch._C.__file__).GOMP_parallel
    except (OSError, AttributeError):
        return None
    parallel.argtypes = [TASK, ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint]
    parallel.restype = None
    return parallel
