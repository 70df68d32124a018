"""A machine's first call: kernels are compiled, and somebody waits.

Exposing and developing take about as long to compile. A second process compiles what comes later,
while this one compiles what it needs now, which halves the wait for a machine's first photo.
"""

from __future__ import annotations

import atexit
import contextlib
import subprocess
import sys
from pathlib import Path

from moireaug.engine.cpu import compiling
from moireaug.engine.cpu.kernel_cache import NOT_KEPT_MESSAGE, has_room, warn_once

PACKAGE_PARENT = Path(__file__).parents[3]
HELPER_CODE = """
import sys
sys.path.append(sys.argv[1])

import torch
from moireaug import Scene, develop
from moireaug.engine.cpu import run
from moireaug.engine.lower.exposure import lower_exposure

shot = Scene.preset("screen_photo").sample(1, (8, 8))
exposure, _ = lower_exposure(shot, decoded=False)
raw = torch.zeros(shot.raw_shape(), requires_grad=True)
run.compile_show(exposure, torch.float32)
photo = develop(raw, shot)
run.compile_show(exposure, torch.uint8)
photo.sum().backward()
"""
# -P: a torch.py in the folder that somebody works in is not what the code means
PYTHON_ARGUMENTS = ("-P", "-c", HELPER_CODE, str(PACKAGE_PARENT))


def prepare() -> None:
    """Start, on a machine's first call, on the kernels that come later, if they can be kept; say so
    if they cannot."""
    folder = compiling.folder()
    if not compiling.is_cold():
        return
    if folder is None:
        warn_once(NOT_KEPT_MESSAGE.format(", as no place for them is writable"))
    elif has_room(folder):
        compile_ahead(folder)


def compile_ahead(folder: str) -> None:
    """Start a process that compiles the kernels of showing a picture, of developing and of
    developing backwards, unless one was started before for this folder of kernels. It ends with
    this process, if not before.

    Nothing depends on it: a kernel that it has not finished is waited for, and one that it has not
    begun is compiled here.

    Args:
        folder: from `compiling.folder`.
    """
    # an interpreter that a program embeds may answer to the program's own options
    if not Path(sys.executable or "").stem.startswith("python"):
        return
    marker = Path(folder, "ahead")
    try:
        marker.touch(exist_ok=False)
        process = subprocess.Popen(
            [sys.executable, *PYTHON_ARGUMENTS],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return
    atexit.register(_stop, process, marker)


def _stop(process: subprocess.Popen, marker: Path) -> None:
    """End the process; unless it has compiled all, another may be started."""
    if process.poll() != 0:
        with contextlib.suppress(OSError):
            marker.unlink()
    process.terminate()
    process.wait()
