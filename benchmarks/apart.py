"""The rows of `speed.py` that need processes of their own: an older checkout, fresh starts,
resident memory."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator

import numpy as np
import torch

from benchmarks.checkouts import HERE, Checkout
from benchmarks.measure import Timing, timed_together
from benchmarks.rows import Row, Size, in_ms
from moireaug import Scene, capture

SCENE = "screen_photo"
STAGES = ("expose", "develop", "develop, forward and backward", "capture")
LIBRARIES = ("torchvision", "albumentations")
WORKERS = 2
TORCH = "import torch"
PHOTO = (
    "import torch, moireaug; scene = moireaug.Scene.preset('screen_photo'); "
    "moireaug.capture(torch.rand(1, 3, 224, 224), scene.sample(1, (224, 224)))"
)
MAX_START_SECONDS, MAX_FIRST_CALL_SECONDS = 1.5, 15.0  # seconds above `import torch` alone


def executions(size: Size) -> Iterator[Row]:
    """Yield the engine against the reference, each in its own process."""
    scene, images = Scene.preset(SCENE).to_dict(), size.images().numpy()
    with Checkout(HERE, size.threads) as fast, Checkout(HERE, size.threads, engine=False) as plain:
        for run in (fast, plain):
            run.ask("hold", key=SCENE, scene=scene, images=images)
        for stage in STAGES:
            calls = {"engine": fast.call(SCENE, stage), "reference": plain.call(SCENE, stage)}
            times = timed_together(calls, size.repeats)
            yield in_ms(
                f"{stage}, the engine", times["engine"], "the reference", times["reference"]
            )


def loaders(size: Size) -> Iterator[Row]:
    """Yield DataLoaders of two single-threaded workers against the older checkout's; uint8, all
    photographed."""
    if not size.before:
        return
    with Checkout(HERE, size.threads) as now, Checkout(size.before, size.threads) as before:
        for library in LIBRARIES:
            calls = {}
            for name, run in (("now", now), ("before", before)):
                run.ask(
                    "load",
                    key=library,
                    library=library,
                    n=size.loaded,
                    side=size.side,
                    batch=size.batch,
                    workers=WORKERS,
                )
                calls[name] = run.call(library, "epoch")
            times = timed_together(calls, size.slow)
            a, b = times["now"] / size.loaded, times["before"] / size.loaded
            what = f"an image of a DataLoader, 2 workers, {library}; {1 / a.median:.0f} images/s"
            yield in_ms(
                what,
                a,
                f"the older checkout, {1 / b.median:.0f} images/s",
                b,
                bar=1 / 5,
                stretch=1 / 8,
            )


def memory(size: Size) -> Iterator[Row]:
    """Yield the peak memory of a capture against that of its images."""
    height, width = size.large
    wanted = {
        f"{size.batch} of {size.side} px": (
            (size.batch, size.side, size.side),
            size.threads,
            {"stretch": 3.0},
        ),
        f"a photo of {height} x {width}": ((1, height, width), 1, {}),
    }
    for what, (shape, threads, stretch) in wanted.items():
        found = []
        for _ in range(min(3, size.slow)):
            with Checkout(HERE, threads) as fresh:
                found.append(fresh.ask("resident_rise", scene=SCENE, shape=shape))
        low, median, high = np.percentile(found, [25, 50, 75]).tolist()
        images = 4 * 3 * math.prod(shape) / 2**20
        yield Row(
            f"peak memory of {what}",
            median,
            low,
            high,
            "MiB",
            "the images",
            images,
            bar=4.0,
            **stretch,
        )


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
    times = timed_together(
        {"torch": start(TORCH), "photo": start(PHOTO)}, size.slow, warmup=min(1, size.slow - 1)
    )
    alone = times["torch"].median
    yield above("import and first photo", times["photo"], alone, MAX_START_SECONDS)
    if size.first:
        cold = timed_together({"cold": cold_start}, size.first, warmup=0)["cold"]
        yield above("the same, first call ever", cold, alone, MAX_FIRST_CALL_SECONDS)


def start(code: str, **environment: str) -> Callable[[], None]:
    """Return a function that runs code in a new interpreter on this checkout."""
    given = os.environ | {"PYTHONPATH": str(HERE)} | environment
    return lambda: subprocess.run([sys.executable, "-c", code], env=given, check=True)


def cold_start() -> None:
    with tempfile.TemporaryDirectory() as empty:
        start(PHOTO, NUMBA_CACHE_DIR=empty)()


def above(what: str, time: Timing, alone: float, allowed: float) -> Row:
    seconds = [s - alone for s in (time.median, time.low, time.high)]
    return Row(f"{what}, above `import torch`", *seconds, "s", "what is allowed", allowed, bar=1.0)
