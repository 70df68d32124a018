"""Loaders of the splits, in the same order on any number of ranks."""

import lightning as L
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.distributed import DistributedSampler

from training.data.splits import Splits, batch_size_for

MAX_VAL_BATCH = 320  # images


def require_even(batch_size: int, processes: int) -> None:
    """Refuse a batch that the processes cannot share evenly."""
    if batch_size % processes:
        near = max(1, round(batch_size / processes)) * processes
        raise ValueError(
            "train.batch_size is that of all processes together, a multiple of their number, "
            f"{processes}; got {batch_size}. The nearest is {near}."
        )


class Batches(L.LightningDataModule):
    """Serves the splits as loaders of images (B, 3, H, W) uint8 and labels (B,) int64.

    The order depends on the seed and the epoch alone, whatever the number of ranks. Each rank gets
    as many images as any other, and where the images cannot be shared evenly a few come twice, in
    training and in validation.

    Args:
        batch_size: training images of a batch on all ranks together; a multiple of their number.
        workers: processes of each loader that read images.
        first_epoch: epoch that training begins or resumes with.
    """

    def __init__(
        self, splits: Splits, batch_size: int, *, workers: int, seed: int, first_epoch: int = 0
    ) -> None:
        super().__init__()
        self.splits, self.batch_size = splits, batch_size
        self.workers, self.seed, self.first_epoch = workers, seed, first_epoch

    def _sampler(self, data: Dataset, *, shuffle: bool) -> DistributedSampler:
        ranks, rank = 1, 0
        if self.trainer is not None:
            ranks, rank = self.trainer.world_size, self.trainer.global_rank
        return DistributedSampler(data, ranks, rank, shuffle=shuffle, seed=self.seed)

    def _loader(self, sampler: DistributedSampler, batch_size: int, drop_last: bool) -> DataLoader:
        size = max(1, batch_size // sampler.num_replicas)
        return DataLoader(
            sampler.dataset,
            size,
            sampler=sampler,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            drop_last=drop_last and len(sampler) > size,
        )

    def train_dataloader(self) -> DataLoader:
        sampler = self._sampler(self.splits.train, shuffle=True)
        # Lightning starts the workers before it has read from which epoch training resumes
        sampler.set_epoch(self.first_epoch)
        return self._loader(sampler, self.batch_size, True)

    def val_dataloader(self) -> DataLoader:
        side = self.splits.val[0][0].shape[-1]
        size = batch_size_for(side, MAX_VAL_BATCH)  # they are attacked, with gradients
        return self._loader(self._sampler(self.splits.val, shuffle=False), size, False)
