"""The test images of an evaluation, in batches."""

import torch
from torch import Tensor
from torch.utils.data import Subset, default_collate

from training.config.schema import Reattack
from training.data.splits import Splits, shuffled_indices

# of a batch by default: a few gigabytes for a large network and its gradients
MAX_BATCH_PIXELS = 25 * 224 * 224
MAX_BATCH_IMAGES = 96


def batch_size_for(side: int, max_images: int) -> int:
    """Return the number of images of a batch that is attacked."""
    return max(1, min(max_images, MAX_BATCH_PIXELS // side**2))


class EvalBatches:
    """The first n test images of a fixed shuffle: `batches[index]` is ((B, 3, H, W) in [0, 1],
    (B,)).

    Args:
        reattack: settings of the attack, of which n, batch_size and seed are used.
    """

    def __init__(self, splits: Splits, reattack: Reattack, side: int, device: torch.device) -> None:
        self.data, self.device = splits.test, device
        total = len(self.data)  # type: ignore[arg-type]
        order = shuffled_indices(total, reattack.seed)
        self.n = min(reattack.n, total)
        self.order, self.rest = order[: self.n], order[self.n :]
        self.size = reattack.batch_size or batch_size_for(side, MAX_BATCH_IMAGES)

    def __len__(self) -> int:
        return -(-self.n // self.size)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        if not 0 <= index < len(self):
            raise IndexError(index)
        rows = self.order[index * self.size : (index + 1) * self.size]
        images, labels = default_collate([self.data[i] for i in rows])
        return images.to(self.device).float() / 255, labels.to(self.device)

    def unattacked_images(self, splits: Splits) -> Subset:
        """Return the images that are not attacked: the training images or, if a folder has no
        split, the remaining test images."""
        if splits.train is not splits.val:
            return Subset(splits.train, range(len(splits.train)))  # type: ignore[arg-type]
        return Subset(splits.test, self.rest)
