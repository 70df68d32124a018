"""Loaders of the splits, in the same order on any number of ranks, and replayed batches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import lightning as L
from torch import Tensor
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.distributed import DistributedSampler

from training.data import Splits
from training.schema import Adversary, Train


class Batch(NamedTuple):
    """A training batch.

    Args:
        images: (B, 3, H, W) uint8. labels: (B,) int64.
        slot: its place among the batches of its window. visit: how often it was trained on before.
    """

    images: Tensor
    labels: Tensor
    slot: int = 0
    visit: int = 0


class Part(DistributedSampler):
    """Yields one part of a rank's shuffled images per epoch: `parts` epochs see each image once.

    The order depends on the seed and the epoch alone, whatever the number of ranks.
    """

    def __init__(self, data: Dataset, ranks: int, rank: int, *, seed: int, parts: int) -> None:
        super().__init__(data, ranks, rank, shuffle=True, seed=seed, drop_last=False)
        self.parts = parts

    def set_epoch(self, epoch: int) -> None:
        round_, self.part = divmod(epoch, self.parts)
        super().set_epoch(round_)

    part = 0

    def __iter__(self) -> Iterator[int]:
        order = list(super().__iter__())
        return iter(order[self.part * len(self) : (self.part + 1) * len(self)])

    def __len__(self) -> int:
        return max(1, super().__len__() // self.parts)


class Replayed:
    """Repeats each `window` batches of a loader `replays` times, one round after the other.

    Args:
        loader: of (images, labels). replays: rounds. window: batches per round.
    """

    def __init__(self, loader: DataLoader, replays: int, window: int) -> None:
        self.loader, self.replays, self.window = loader, replays, window
        self.sampler = loader.sampler  # Lightning sets its epoch

    def __len__(self) -> int:
        return self.replays * len(self.loader)

    def __iter__(self) -> Iterator[Batch]:
        held: list[Any] = []
        for n, pair in enumerate(self.loader, 1):
            images, labels = pair
            yield Batch(images, labels, slot=len(held))
            held.append(pair)
            if len(held) == self.window or n == len(self.loader):
                for visit in range(1, self.replays):
                    for slot, (images, labels) in enumerate(held):
                        yield Batch(images, labels, slot=slot, visit=visit)
                held = []


class Batches(L.LightningDataModule):
    """Serves the splits as loaders.

    With a recipe that replays its batches n times, an epoch sees an n-th of the images n times, so
    that the optimiser takes as many steps per epoch as with any other recipe.

    Args:
        splits: the images.
        train: says the batch size, of all devices together.
        adversary: says how often batches are replayed, and in which windows.
        workers: processes of each loader that read images.
        seed: of the order of the images.
        first: the epoch that training begins or resumes with.
    """

    def __init__(
        self,
        splits: Splits,
        train: Train,
        adversary: Adversary,
        *,
        workers: int,
        seed: int,
        first: int = 0,
    ) -> None:
        super().__init__()
        self.splits, self.batch_size, self.adversary = splits, train.batch_size, adversary
        self.workers, self.seed, self.first = workers, seed, first

    def _ranks(self) -> tuple[int, int]:
        """Return the number of processes and which of them this is."""
        if self.trainer is None:
            return 1, 0
        return self.trainer.world_size, self.trainer.global_rank

    def _loader(self, sampler: DistributedSampler, batch_size: int, drop_last: bool) -> DataLoader:
        size = max(1, batch_size // self._ranks()[0])
        return DataLoader(
            sampler.dataset,
            size,
            sampler=sampler,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            drop_last=drop_last and len(sampler) > size,
        )

    def train_dataloader(self) -> Replayed:
        replays = self.adversary.replays
        sampler = Part(self.splits.train, *self._ranks(), seed=self.seed, parts=replays)
        # Lightning starts the workers before it has read from which epoch training resumes
        sampler.set_epoch(self.first)
        return Replayed(
            self._loader(sampler, self.batch_size, True), replays, self.adversary.window
        )

    def val_dataloader(self) -> DataLoader:
        sampler: DistributedSampler = DistributedSampler(
            self.splits.val, *self._ranks(), shuffle=False
        )
        return self._loader(sampler, 320, False)
