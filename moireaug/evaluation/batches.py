"""The batches of an evaluation: images and labels, read from any loader, and their random numbers.
These depend only on the seed, on a batch's index and on the names of condition and classifier, so
that any process, now or later, draws the same."""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from moireaug.attacks.checks import as_tensor, check_labels
from moireaug.common.argument_checks import check_whole
from moireaug.common.image_checks import check_images
from moireaug.mixtures import Mixture
from moireaug.scene.draws import mix_seeds
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Scene, Shot

Batch = tuple[Tensor, Tensor]  # images and labels


class Batches(Protocol):
    """Test images in batches, by index: (images (B, 3, H, W) in [0, 1], labels (B,))."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Batch: ...


def collect_batches(loader: Iterable[Batch], n: int | None) -> list[Batch]:
    """Return the first n images of a loader, in its batches; empty ones are left out.

    Raises:
        ValueError, TypeError: no images, an n below 1, or batches that are not pairs of images and
            class indices.
    """
    if n is not None:
        check_whole("n", n, 1, noun="how many images, or None for all")
        n = int(n)  # NumPy's may wrap around
    if not isinstance(loader, Iterable):
        raise TypeError(
            f"loader must yield batches of (images, labels); got a {type(loader).__name__}."
        )
    batches = []
    left = n
    for pair in loader:
        images, labels = (part[:left] for part in _as_tensors(pair))
        if len(images):
            batches.append((check_images(images), check_labels(labels, len(images), "labels")))
        if left is not None:
            left -= len(images)
            if left <= 0:
                break
    if not batches:
        raise ValueError("loader yields no images: there is nothing to attack.")
    return batches


def _as_tensors(pair: object) -> tuple[Tensor, Tensor]:
    """Return a batch of a loader as images and labels; uint8 images as float in [0, 1]."""
    if isinstance(pair, Tensor):
        raise ValueError(
            "loader must yield (images, labels); got a tensor. Put a single batch into a list: "
            "[(images, labels)]."
        )
    if not isinstance(pair, Sequence) or len(pair) != 2:
        description, selectors = f"a {type(pair).__name__}", "b['image'], b['label']"
        if isinstance(pair, Sequence):
            description, selectors = f"{description} of {len(pair)}", "b[0], b[1]"
        raise ValueError(
            f"loader must yield (images, labels); got {description}. Wrap it: (({selectors}) for b "
            "in loader)."
        )
    images, labels = (
        part if isinstance(part, Tensor) else as_tensor(np.asarray(part), name)
        for part, name in zip(pair, ("images", "labels"), strict=True)
    )
    if labels.ndim == 2 and len(labels) == len(images) and images.ndim == 4:
        advice = "labels.argmax(1) if they are one-hot"
        if labels.shape[1] == 1:
            advice = "labels[:, 0]"
        raise ValueError(
            f"loader must yield labels (B,), one class each; got {tuple(labels.shape)}. Pass "
            f"{advice}."
        )
    if labels.ndim != 1:
        raise ValueError(
            "loader must yield batches of images (B, 3, H, W) and labels (B,); got "
            f"{tuple(images.shape)} and {tuple(labels.shape)}. Wrap single images: "
            "DataLoader(data, 32)."
        )
    if len(labels) != len(images) and images.ndim == 4:
        raise ValueError(
            f"loader must yield one label per image; got {len(labels)} labels for {len(images)} "
            "images."
        )
    if images.dtype == torch.uint8:
        images = images.float() / 255
    if images.is_floating_point():
        images = images.float()
    return images, labels


# streams of random numbers, by their purpose
SHOT_STREAM, TARGET_STREAM, CONDITION_STREAM, SHOW_STREAM, ANSWER_STREAM = range(5)


@contextlib.contextmanager
def restored_generators() -> Iterator[None]:
    """Restore torch's global generators, of the CPU and of all GPUs, which `torch.manual_seed`
    seeds together, on exit: a randomised model or defence draws from them."""
    devices = range(torch.cuda.device_count()) if torch.cuda.is_initialized() else ()
    with torch.random.fork_rng(devices):
        yield


@dataclass(frozen=True)
class SeededBatch:
    """The images (B, 3, H, W) and labels (B,) of the batch of an index, and its random numbers.

    Args:
        seed: seed of the evaluation.
        classes: number of classes of the model.
    """

    seed: int
    index: int
    images: Tensor
    labels: Tensor
    classes: int

    @cached_property
    def targets(self) -> Tensor:
        """One of the other classes for each label, (B,)."""
        generator, shape = self.generator(TARGET_STREAM), self.labels.shape
        offset = torch.randint(1, self.classes, shape, generator=generator, device="cpu")
        return (self.labels + offset.to(self.labels)) % self.classes

    def shot(self, scene: Scene | Mixture) -> Shot | MixedShot:
        """Draw a shot for each image."""
        size = (self.images.shape[-2], self.images.shape[-1])
        shot = scene.sample(len(self.images), size, self.generator(SHOT_STREAM))
        return shot.to(self.images.device)

    def generator(self, stream: int, *names: str) -> torch.Generator:
        """Return the generator of a stream, and of the condition of that name."""
        return torch.Generator().manual_seed(self.seed_of(stream, *names))

    def seed_of(self, stream: int, *names: str) -> int:
        """Return the seed of a stream, and of condition and classifier of these names."""
        numbers = (zlib.crc32(name.encode()) for name in names)  # the same on every machine
        return mix_seeds(self.seed, self.index, stream, *numbers)
