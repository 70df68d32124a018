"""The rows of `speed.py` of memory, of a photo of 12 megapixels, and of fresh starts, also of a
DataLoader's workers."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from benchmarks.measure import ROOT, Timing, timed_together
from benchmarks.rows import Row, Size
from moireaug import Scene, capture

SCENE = "screen_photo"
TORCH_CODE = "import torch"
PHOTO_CODE = (
    "import torch, moireaug; scene = moireaug.Scene.preset('screen_photo'); "
    "moireaug.capture(torch.rand(1, 3, 224, 224), scene.sample(1, (224, 224)))"
)
MEMORY_CODE = (
    "from benchmarks.memory_and_starts import resident_rise; "
    "print(resident_rise({shape}, {threads}))"
)
# seconds until the first batch of two epochs
WORKERS_CODE = """
import time, torch
from torch.utils.data import DataLoader
from moireaug.transforms import RandomMoire
moire = RandomMoire(p=1.0)
if {warm}:
    moire(torch.rand(3, 224, 224))
class Photos(torch.utils.data.Dataset):
    def __len__(self):
        return 64
    def __getitem__(self, k):
        return moire(torch.rand(3, 224, 224))
loader = DataLoader(Photos(), 4, num_workers=1, persistent_workers={kept},
                    multiprocessing_context="fork")
for epoch in range(2):
    began = time.perf_counter()
    batches = iter(loader)
    next(batches)
    print(time.perf_counter() - began)
    for _ in batches:
        pass
"""
MAX_START_SECONDS, MAX_FIRST_CALL_SECONDS = 1.5, 15.0  # seconds above `import torch` alone


def run_apart(code: str, **environment: str) -> str:
    """Run code in a new interpreter on this checkout, and return its output."""
    given = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=given, check=True, stdout=subprocess.PIPE, text=True).stdout


def memory(size: Size) -> Iterator[Row]:
    """Yield the peak memory of a capture against that of its images."""
    height, width = size.large
    batch = (size.batch, size.side, size.side)
    yield peak_memory(f"{size.batch} of {size.side} px", batch, size.threads, size.slow, 3.0)
    yield peak_memory(f"a photo of {height} x {width}", (1, height, width), 1, size.slow)


def peak_memory(
    images: str,
    shape: tuple[int, int, int],
    threads: int,
    repeats: int,
    stretch: float | None = None,
) -> Row:
    """Return the row of images of a shape, each measured in a process of its own."""
    code = MEMORY_CODE.format(shape=shape, threads=threads)
    rises = [float(run_apart(code)) for _ in range(min(3, repeats))]
    low, median, high = np.percentile(rises, [25, 50, 75]).tolist()
    own = 4 * 3 * math.prod(shape) / 2**20
    name = f"peak memory of {images}"
    return Row(name, median, low, high, "MiB", "the images", own, bar=4.0, stretch=stretch)


def resident_rise(shape: tuple[int, int, int], threads: int) -> float:
    """Return by how many MiB the first capture of such images raises this process's resident set,
    its photo included.

    It counts all that a capture touches, scratch space and what the allocator could not reuse
    included.
    """
    torch.set_num_threads(threads)
    scene = Scene.preset(SCENE)
    # libraries are loaded, kernels compiled
    capture(torch.rand(1, 3, 16, 16), scene.sample(1, (16, 16)))
    batch, height, width = shape
    images, shot = torch.rand(batch, 3, height, width), scene.sample(batch, (height, width))
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before = _status("VmRSS")
    capture(images, shot)
    return _status("VmHWM") - before


def _status(key: str) -> float:
    # not getrusage: its peak is inherited from the process that started this one
    for line in Path("/proc/self/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == key:
            return int(value.split()[0]) / 1024
    raise OSError(f"/proc/self/status has no {key}")


def large_photo(size: Size) -> Iterator[Row]:
    """Yield a photo of 12 megapixels on one thread against a batch of small ones with the same
    draw."""
    scene, seed = Scene.preset(SCENE), torch.Generator()
    small = scene.sample(1, (size.side, size.side), seed.manual_seed(0))[
        torch.zeros(size.batch, dtype=torch.long)
    ]
    large = scene.sample(1, size.large, seed.manual_seed(0))
    images, image = size.images(), torch.rand(1, 3, *size.large)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        calls = {"small": lambda: capture(images, small), "large": lambda: capture(image, large)}
        times = timed_together(calls, size.slow)
    finally:
        torch.set_num_threads(threads)
    a, b = times["large"] / image[0, 0].numel(), times["small"] / images[:, 0].numel()
    h, w = size.large
    what = f"a pixel of {h} x {w}, 1 thread; {times['large'].median:.1f} s a photo"
    ns = [1e9 * s for s in (a.median, a.low, a.high)]
    yield Row(
        what,
        *ns,
        "ns",
        f"a pixel of {size.side} x {size.side}",
        1e9 * b.median,
        bar=1.2,
        stretch=1.0,
    )


def starts(size: Size) -> Iterator[Row]:
    """Yield import and first photo above `import torch` alone: with compiled kernels, and on a
    machine's very first call."""
    calls = {"torch": lambda: run_apart(TORCH_CODE), "photo": lambda: run_apart(PHOTO_CODE)}
    times = timed_together(calls, size.slow, warmup=min(1, size.slow - 1))
    alone = times["torch"].median
    yield above("import and first photo", times["photo"], alone, MAX_START_SECONDS)
    if size.first:
        cold = timed_together({"cold": cold_start}, size.first, warmup=0)["cold"]
        yield above("the same, first call ever", cold, alone, MAX_FIRST_CALL_SECONDS)


def cold_start() -> None:
    with tempfile.TemporaryDirectory() as empty:
        run_apart(PHOTO_CODE, NUMBA_CACHE_DIR=empty)


def above(what: str, time: Timing, alone: float, allowed: float) -> Row:
    seconds = [s - alone for s in (time.median, time.low, time.high)]
    return Row(f"{what}, above `import torch`", *seconds, "s", "what is allowed", allowed, bar=1.0)


def workers(size: Size) -> Iterator[Row]:
    """Yield the time until a DataLoader's first batch of four photos, which one worker takes: in
    the first epoch and in the second, with workers that are kept, and after a photo in the process
    that starts them."""
    cases = ((False, False), (False, True), (True, False)) if size.first else ()
    for warm, kept in cases:
        code = WORKERS_CODE.format(warm=warm, kept=kept)
        runs = [run_apart(code, OMP_NUM_THREADS="1") for _ in range(min(3, size.slow))]
        seconds = np.array([[float(line) for line in run.split()] for run in runs])
        name = f"first batch, {'after a photo' if warm else 'no photo before'}"
        name += f", persistent_workers={kept}"
        for epoch, column in enumerate(seconds.T):
            low, median, high = np.percentile(column, [25, 50, 75]).tolist()
            yield Row(f"{name}, epoch {epoch + 1}", median, low, high, "s")
