"""The rows of `speed.py` of memory, of a photo of 12 megapixels, and of fresh starts."""

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
