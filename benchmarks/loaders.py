"""Images a second through a DataLoader with two workers, with and without a transform."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch.utils.data import DataLoader, Dataset

from moireaug.transforms import RandomMoire, albumentations

WORKERS = 2


class Pictures(Dataset):
    """One uint8 image, n times, through a transform."""

    def __init__(self, n: int, image: Any, transform: Callable[[Any], Any]) -> None:
        self.n, self.image, self.transform = n, image, transform

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, i: int) -> Any:
        return self.transform(self.image)


def planes(transform: Callable[[Any], Any] | None, n: int, side: int) -> Pictures:
    """As torchvision has images: tensors (3, side, side)."""
    return Pictures(n, torch.randint(0, 256, (3, side, side), dtype=torch.uint8), transform or (lambda image: image))


def arrays(transform: Callable[..., Any] | None, n: int, side: int) -> Pictures:
    """As albumentations has images: arrays (side, side, 3)."""
    image = torch.randint(0, 256, (side, side, 3), dtype=torch.uint8).numpy()
    return Pictures(n, image, (lambda image: transform(image=image)["image"]) if transform else (lambda image: image))


def epochs(n: int, side: int, batch: int) -> dict[str, Callable[[], None]]:
    """An epoch of each loader, the workers of which stay alive, so that their start is not timed."""
    sets = {
        "tensors": planes(None, n, side),
        "torchvision": planes(RandomMoire(p=1), n, side),
        "arrays": arrays(None, n, side),
        "albumentations": arrays(albumentations.RandomMoire(p=1), n, side),
    }
    return {name: _epoch(data, batch) for name, data in sets.items()}


def _epoch(data: Pictures, batch: int) -> Callable[[], None]:
    # forked workers inherit the data set, whose transforms are closures
    loader = DataLoader(data, batch, num_workers=WORKERS, persistent_workers=True, multiprocessing_context="fork")

    def run() -> None:
        for _ in loader:
            pass

    return run
