"""How much memory a capture takes at its peak, in MiB, above what was there before it."""

from __future__ import annotations

import json
import multiprocessing
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import torch
from torch.profiler import ProfilerActivity, profile

from moireaug import Scene, capture

SCENE = "screen_photo"


def in_fresh_process(batch: int, side: int) -> float:
    """By Linux: how far the first capture of that size lifts the resident set of a new process.

    It holds all that a capture touches, scratch space and what the allocator could not reuse included.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_resident_rise, batch, side).result()


@torch.no_grad()
def _resident_rise(batch: int, side: int) -> float:
    scene = Scene.preset(SCENE)
    capture(torch.rand(1, 3, 16, 16), scene.sample(1, (16, 16)))  # libraries are loaded, kernels are chosen
    images, shot = torch.rand(batch, 3, side, side), scene.sample(batch, (side, side))
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before = _status("VmRSS")
    capture(images, shot)
    return _status("VmHWM") - before


def _status(key: str) -> float:
    # not getrusage: its peak is inherited from the process that started this one
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines[key].split()[0]) / 1024


def allocated(batch: int, side: int, gradients: bool) -> float:
    """By torch's profiler: the greatest sum of all live allocations of its own allocator."""
    scene = Scene.preset(SCENE)
    images, shot = torch.rand(batch, 3, side, side, requires_grad=gradients), scene.sample(batch, (side, side))
    os.environ.setdefault("KINETO_LOG_LEVEL", "99")  # the profiler's own talk
    with torch.set_grad_enabled(gradients):
        capture(images[:1], shot[:1])
        with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as run:
            photo = capture(images, shot)
            if gradients:
                photo.sum().backward()
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace.json"
        run.export_chrome_trace(str(trace))
        events = json.loads(trace.read_text())["traceEvents"]
    counts = [e["args"] for e in events if e.get("name") == "[memory]"]
    start = counts[0]["Total Allocated"] - counts[0]["Bytes"]
    return (max(c["Total Allocated"] for c in counts) - start) / 2**20
