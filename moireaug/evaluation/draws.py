"""The random numbers of an evaluation. They depend only on its seed, on a batch's index and on the
names of condition and classifier, so that any process, now or later, draws the same."""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from moireaug.mixtures import Mixture
from moireaug.scene.draws import mix_seeds
from moireaug.scene.mixed_shot import MixedShot
from moireaug.scenes import Scene, Shot

# streams of random numbers, by their purpose
SHOT_STREAM, TARGET_STREAM, CONDITION_STREAM, SHOW_STREAM, ANSWER_STREAM = range(5)


@contextlib.contextmanager
def restored_generators(device: torch.device) -> Iterator[None]:
    """Restore torch's global generators, of the CPU and of a device, on exit: a randomised model or
    defence draws from them."""
    devices = [device] if device.type == "cuda" else []
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
