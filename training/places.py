"""The test images of an evaluation, by place."""

from __future__ import annotations

import torch
from omegaconf import DictConfig
from torch import Tensor
from torch.utils.data import Subset, default_collate

from training.data import Splits

PIXELS = 25 * 224 * 224  # of a batch whose size nobody gave: some gigabytes for a large network and its gradients
MOST = 96


class Places:
    """The first n test images of a fixed shuffle, in batches: `places[place]` is ((B, 3, H, W) in [0, 1], (B,))."""

    def __init__(self, splits: Splits, cfg: DictConfig, device: torch.device) -> None:
        self.data, self.device = splits.test, device
        order = torch.randperm(len(self.data), generator=torch.Generator().manual_seed(cfg.reattack.seed)).tolist()  # type: ignore[arg-type]
        self.n = min(cfg.reattack.n, len(order))
        self.order, self.rest = order[: self.n], order[self.n :]
        self.size = cfg.reattack.batch_size or max(1, min(MOST, PIXELS // cfg.data.size**2))

    def __len__(self) -> int:
        return -(-self.n // self.size)

    def __getitem__(self, place: int) -> tuple[Tensor, Tensor]:
        if not 0 <= place < len(self):
            raise IndexError(place)
        rows = self.order[place * self.size : (place + 1) * self.size]
        images, labels = default_collate([self.data[i] for i in rows])
        return images.to(self.device).float() / 255, labels.to(self.device)

    def others(self, splits: Splits) -> Subset:
        """Images that are not attacked here: those of training, or, where a folder has no split, the rest of it."""
        if splits.train is not splits.val:
            return Subset(splits.train, range(len(splits.train)))  # type: ignore[arg-type]
        return Subset(splits.test, self.rest)
