"""Compiles all CPU kernels beforehand, as for containers: `python -m moireaug.warm_up`.

It takes one to several minutes, and nothing where they are compiled already. Kernels are kept in
the first of these folders that can be written to: NUMBA_CACHE_DIR, the package's own, and
~/.cache/moireaug.
"""

from __future__ import annotations

import sys
import time

import torch

from moireaug.capture import capture, reading_of
from moireaug.engine.backends import why_no_kernels
from moireaug.scenes import Scene

SIZE = (8, 8)
# a scene of each kind of reading
SCENES = {
    "binned readings": Scene.preset("screen_photo"),
    "full readings": Scene(),
    "readings at points": Scene.preset("paper_code"),
}


def warm_up() -> None:
    """Take a photo of each kind of reading, with a gradient, and one of a uint8 picture; print a
    line for each."""
    for i, (name, scene) in enumerate(SCENES.items()):
        start = time.monotonic()
        shot = scene.sample(1, SIZE)
        images = torch.zeros(1, 3, *SIZE, requires_grad=True)
        capture(images, shot).sum().backward()
        reading_of(images.detach().byte(), shot)
        seconds = time.monotonic() - start
        print(f"{i + 1} of {len(SCENES)}: {name}, {seconds:.0f} s", flush=True)


def main() -> int:
    """Compile all kernels; return 0 if they are kept for other processes."""
    if why_not := why_no_kernels("cpu"):
        print(f"There is nothing to compile: {why_not}.", file=sys.stderr)
        return 1
    warm_up()
    # now that numba is imported anyway
    from moireaug.engine.cpu import compiling, kernel_cache

    folder = compiling.folder()
    if folder is None or kernel_cache.KernelCache.is_full:
        return 1  # as a warning has said
    print(f"All CPU kernels are in {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
