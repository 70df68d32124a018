"""The random numbers of an evaluation. They depend only on its seed, on a batch's index and on the
names of condition and classifier, so that any process, now or later, draws the same."""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

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
class BatchDraws:
    """The random numbers of the batch of an index, by the seed of the evaluation."""

    seed: int
    index: int

    def targets(self, labels: Tensor, classes: int) -> Tensor:
        """Draw one of the other classes for each label, (B,)."""
        generator = self.generator(TARGET_STREAM)
        offset = torch.randint(1, classes, labels.shape, generator=generator, device="cpu")
        return (labels + offset.to(labels)) % classes

    def shots(self, scene: Scene | Mixture, images: Tensor) -> list[tuple[Tensor, Shot]]:
        """Draw a shot for each image: for each scene of a mixture, the rows (b,) of its images, and
        their shot."""
        size = (images.shape[-2], images.shape[-1])
        shot = scene.sample(len(images), size, self.generator(SHOT_STREAM)).to(images.device)
        if isinstance(shot, MixedShot):
            return shot.by_scene()
        return [(torch.arange(len(images), device=images.device), shot)]

    def generator(self, stream: int, *names: str) -> torch.Generator:
        """Return the generator of a stream, and of the condition of that name."""
        return torch.Generator().manual_seed(self.seed_of(stream, *names))

    def seed_of(self, stream: int, *names: str) -> int:
        """Return the seed of a stream, and of condition and classifier of these names."""
        numbers = (zlib.crc32(name.encode()) for name in names)  # the same on every machine
        return mix_seeds(self.seed, self.index, stream, *numbers)
