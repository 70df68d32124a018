"""What runs in a process of its own, on this or an older checkout of the project;
`checkouts.Checkout` starts it.

    python benchmarks/worker.py ROOT THREADS

Reads pickled pairs of a name and its arguments, calls the function of that name and answers each
with its pickled result. Imports nothing of `benchmarks`, which may differ in ROOT, and only public
names of `moireaug`.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path[0] = sys.argv[1]  # before the checkout that is installed

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

import moireaug
from moireaug import Scene

Call = Callable[[], Any]
# by the key of a capture or loader, and what is done with it
CALLS: dict[tuple[str, str], Call] = {}


def where() -> str:
    return moireaug.__file__


def hold(key: str, scene: dict[str, Any], images: np.ndarray) -> None:
    """Draw a shot of these images, and keep what can be run on it under `key`."""
    drawn = Scene.from_dict(scene)
    shown = torch.from_numpy(images)
    shot = drawn.sample(len(shown), tuple(shown.shape[-2:]), torch.Generator().manual_seed(0))
    raw = moireaug.expose(shown, shot)

    @torch.enable_grad()
    def back() -> Tensor:
        asked = raw.clone().requires_grad_(True)
        return torch.autograd.grad(moireaug.develop(asked, shot).sum(), asked)[0]

    CALLS[key, "expose"] = lambda: moireaug.expose(shown, shot)
    CALLS[key, "develop"] = lambda: moireaug.develop(raw, shot)
    CALLS[key, "develop, forward and backward"] = back
    CALLS[key, "capture"] = lambda: moireaug.capture(shown, shot)
    CALLS[key, "first reading"] = lambda: moireaug.expose(shown[:1], shot[:1]).numpy()


def load(key: str, library: str, n: int, side: int, batch: int, workers: int) -> None:
    """Keep a DataLoader's epoch of n uint8 images, all photographed; the workers stay alive, so
    that their start is not timed."""
    from moireaug.transforms import RandomMoire, albumentations

    picture = torch.randint(0, 256, (3, side, side), dtype=torch.uint8)
    transform = RandomMoire(p=1)
    if library == "albumentations":
        picture = picture.movedim(0, -1).contiguous().numpy()
        whole = albumentations.RandomMoire(p=1)
        transform = lambda image: whole(image=image)["image"]  # noqa: E731
    # forked workers inherit the data set, whose transform may be a closure
    context = "fork" if workers else None
    pictures = Pictures(n, picture, transform)
    loader = DataLoader(
        pictures,
        batch,
        num_workers=workers,
        persistent_workers=bool(workers),
        multiprocessing_context=context,
    )
    CALLS[key, "epoch"] = lambda: [None for _ in loader]


class Pictures(Dataset):
    """One image, n times, through a transform."""

    def __init__(self, n: int, image: Any, transform: Callable[[Any], Any]) -> None:
        self.n, self.image, self.transform = n, image, transform

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, i: int) -> Any:
        return self.transform(self.image)


def run(key: str, what: str) -> None:
    CALLS[key, what]()


def result(key: str, what: str) -> Any:
    return CALLS[key, what]()


def resident_rise(scene: str, shape: tuple[int, int, int]) -> float:
    """Return by how many MiB the first capture of such images raises this process's resident set,
    its photo included.

    It counts all that a capture touches, scratch space and what the allocator could not reuse
    included.
    """
    drawn = Scene.preset(scene)
    # libraries are loaded, kernels compiled
    moireaug.capture(torch.rand(1, 3, 16, 16), drawn.sample(1, (16, 16)))
    batch, height, width = shape
    images, shot = torch.rand(batch, 3, height, width), drawn.sample(batch, (height, width))
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before = _status("VmRSS")
    moireaug.capture(images, shot)
    return _status("VmHWM") - before


def _status(key: str) -> float:
    # not getrusage: its peak is inherited from the process that started this one
    for line in Path("/proc/self/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == key:
            return int(value.split()[0]) / 1024
    raise OSError(f"/proc/self/status has no {key}")


def main() -> None:
    torch.set_num_threads(int(sys.argv[2]))
    torch.manual_seed(0)
    # whatever is printed must not end up among the answers
    answers, sys.stdout = sys.stdout.buffer, sys.stderr
    with torch.no_grad():
        while True:
            try:
                name, arguments = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            pickle.dump(globals()[name](**arguments), answers)
            answers.flush()


if __name__ == "__main__":
    main()
