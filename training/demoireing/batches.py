"""Simulated pairs in batches, for Lightning."""

from collections.abc import Iterator

import lightning as L
import torch
from torch.utils.data import DataLoader, Sampler, TensorDataset

from moireaug.synthesis.pictures import Source
from training.demoireing.pairs import VAL_SEED, SimulatedPairs, TurnedPairs, training_scenes
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig

VAL_BATCH = 16


class PairNumbers(Sampler[int]):
    """The numbers of one rank's pairs in an epoch, different in every epoch.

    Args:
        count: pairs of an epoch, of all ranks together.
    """

    def __init__(self, count: int, ranks: int, rank: int) -> None:
        self.count, self.ranks, self.rank, self.epoch = count, ranks, rank, 0

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch; Lightning calls it."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[int]:
        start = self.epoch * self.count
        return iter(range(start + self.rank, start + self.count, self.ranks))

    def __len__(self) -> int:
        return len(range(self.rank, self.count, self.ranks))


class PairBatches(L.LightningDataModule):
    """Serves pairs as loaders; the validation pairs are made once.

    Args:
        first_epoch: epoch that training begins or resumes with.
    """

    def __init__(self, cfg: DemoireConfig, splits: Splits, first_epoch: int = 0) -> None:
        super().__init__()
        self.cfg, self.splits, self.first_epoch = cfg, splits, first_epoch
        self.scenes = list(training_scenes(cfg).values())

    def _pairs(self, pictures: Source, seed: int, count: int) -> TurnedPairs:
        data, target = self.cfg.data, self.cfg.demoire.target
        pairs = SimulatedPairs(
            pictures, self.scenes, data.size, target, seed, data.subsample, data.jpeg
        )
        return TurnedPairs(pairs, count, data.candidates)

    def train_dataloader(self) -> DataLoader:
        ranks, rank = self.trainer.world_size, self.trainer.global_rank  # type: ignore[union-attr]
        train, workers = self.cfg.train, self.cfg.data.workers
        numbers = PairNumbers(train.check_every * train.batch_size, ranks, rank)
        # Lightning starts the workers before it has read from which epoch training resumes
        numbers.set_epoch(self.first_epoch)
        return DataLoader(
            self._pairs(self.splits.train, self.cfg.seed, self.cfg.data.pairs),
            train.batch_size // ranks,
            sampler=numbers,
            num_workers=workers,
            persistent_workers=workers > 0,
            multiprocessing_context="spawn" if workers else None,  # threads do not survive a fork
        )

    def val_dataloader(self) -> DataLoader:
        count = self.cfg.data.val
        pairs = self._pairs(self.splits.val, VAL_SEED, count)
        val_pairs = [pairs[k] for k in range(count)]
        photos, targets = (torch.stack(side) for side in zip(*val_pairs, strict=True))
        return DataLoader(TensorDataset(photos, targets), VAL_BATCH)
