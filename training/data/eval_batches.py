"""The test images of an evaluation, in batches."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.data import Subset, default_collate

from training.config.schema import Reattack
from training.data.splits import Splits, shuffled

# of a batch by default: a few gigabytes for a large network and its gradients
PIXELS = 25 * 224 * 224
MOST = 96


class EvalBatches:
    """The first n test images of a fixed shuffle: `batches[index]` is ((B, 3, H, W) in [0, 1],
    (B,)).

    Args:
        splits: of the data. reattack: its n, batch_size and seed are used. side: of the images, in
            pixels.
        device: where the batches go.
    """

    def __init__(self, splits: Splits, reattack: Reattack, side: int, device: torch.device) -> None:
        self.data, self.device = splits.test, device
        total = len(self.data)  # type: ignore[arg-type]
        order = shuffled(total, reattack.seed)
        self.n = min(reattack.n, total)
        self.order, self.rest = order[: self.n], order[self.n :]
        self.size = reattack.batch_size or max(1, min(MOST, PIXELS // side**2))

    def __len__(self) -> int:
        return -(-self.n // self.size)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        if not 0 <= index < len(self):
            raise IndexError(index)
        rows = self.order[index * self.size : (index + 1) * self.size]
        images, labels = default_collate([self.data[i] for i in rows])
        return images.to(self.device).float() / 255, labels.to(self.device)

    def others(self, splits: Splits) -> Subset:
        """Return images that are not attacked: the training images or, if a folder has no split,
        the rest."""
        if splits.train is not splits.val:
            return Subset(splits.train, range(len(splits.train)))  # type: ignore[arg-type]
        return Subset(splits.test, self.rest)
