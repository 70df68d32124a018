"""Three parts of a data set, to train, validate and test on; and the test images in batches."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.utils.data import Dataset, Subset, default_collate

from moireaug.attacks import predicted
from training.config.data_sets import Data
from training.config.schema import Reattack

MAX_CACHE_BYTES = 1 << 30  # of decoded images
# of a batch by default: a few gigabytes for a large network and its gradients
MAX_BATCH_PIXELS = 25 * 224 * 224
MAX_BATCH_IMAGES = 96


class ImageSet(NamedTuple):
    """A data set as it is published.

    Args:
        train, test: images (3, size, size) uint8 with labels; train is None where all are for
            testing.
        classes, num_classes, files: as in `Splits`.
    """

    train: Dataset | None
    test: Dataset
    classes: dict[int, str]
    num_classes: int
    files: str = ""


class Splits(NamedTuple):
    """Three data sets of images (3, size, size) uint8 with labels, and their classes.

    Args:
        train, val, test: images to train, validate and test on.
        num_classes: number of logits of a model for them.
        files: fingerprint of the files of train and val; empty where the settings determine these
            images.
    """

    train: Dataset
    val: Dataset
    test: Dataset
    classes: dict[int, str]
    num_classes: int
    files: str = ""


class CachedDataset(Dataset):
    """A data set whose images stay in memory once they are read, for later epochs."""

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self.items: dict[int, tuple[Tensor, int]] = {}

    def __len__(self) -> int:
        return len(self.data)  # type: ignore[arg-type]

    def __getitem__(self, index: int) -> tuple[Tensor, int]:
        if index not in self.items:
            self.items[index] = self.data[index]
        return self.items[index]


def cache_if_small(data: Dataset, cfg: Data) -> Dataset:
    """Return a data set that is cached in memory if it is small and no workers, which share no
    memory, read it."""
    size = len(data) * 3 * cfg.size**2  # type: ignore[arg-type]
    return data if cfg.workers or size > MAX_CACHE_BYTES else CachedDataset(data)


def shuffled_indices(n: int, seed: int) -> list[int]:
    """Return the indices below n in a random order, the same for a seed."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randperm(n, generator=generator, device="cpu").tolist()


def random_subset(data: Dataset, n: int | None) -> Dataset:
    """Return a fixed random subset of n items; all of them if n is None or not smaller."""
    if n is None or n >= len(data):  # type: ignore[arg-type]
        return data
    return Subset(data, shuffled_indices(len(data), 0)[:n])  # type: ignore[arg-type]


def repeated(data: Dataset, n: int | None) -> Dataset:
    """Return n items, each as often as any other or once more; as many as there are if n is None
    or not greater."""
    total = len(data)  # type: ignore[arg-type]
    return data if n is None or n <= total else Subset(data, [k % total for k in range(n)])


def split(images: ImageSet, cfg: Data) -> Splits:
    """Return the parts of a data set, in the numbers that are asked for: of the training images, a
    fixed random part is held out for validation."""
    all_test = cache_if_small(images.test, cfg)
    test = random_subset(all_test, cfg.test)
    if images.train is None:
        return Splits(all_test, all_test, test, images.classes, images.num_classes)
    all_train = cache_if_small(images.train, cfg)
    total = len(all_train)  # type: ignore[arg-type]
    val_count = cfg.val if cfg.val is not None else max(1, total // 10)
    if not 0 < val_count < total:
        raise ValueError(
            f"data.val must be at least 1 and leave training images; got {val_count} of {total}. "
            "Pass another data.val=N."
        )
    order = shuffled_indices(total, 0)
    train = random_subset(Subset(all_train, order[val_count:]), cfg.train)
    val = Subset(all_train, order[:val_count])
    return Splits(train, val, test, images.classes, images.num_classes, images.files)


def batch_size_for(side: int, max_images: int) -> int:
    """Return the number of images of a batch that is attacked."""
    return max(1, min(max_images, MAX_BATCH_PIXELS // side**2))


class EvalBatches:
    """The first n test images of a fixed shuffle: `batches[index]` is ((B, 3, H, W) in [0, 1],
    (B,)).

    Args:
        reattack: settings of the attack, of which n, batch_size and seed are used.
        original: classifier whose answers are the labels; None for those of the data.
    """

    def __init__(
        self,
        splits: Splits,
        reattack: Reattack,
        side: int,
        device: torch.device,
        original: nn.Module | None = None,
    ) -> None:
        self.data, self.device = splits.test, device
        self.original = original.to(device).eval() if original else None
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
        images = images.to(self.device).float() / 255
        if self.original:
            with torch.no_grad():
                labels = predicted(self.original(images))
        return images, labels.to(self.device)

    def unattacked_images(self, splits: Splits) -> Subset:
        """Return the images that are not attacked: the training images or, if a folder has no
        split, the remaining test images."""
        if splits.train is not splits.val:
            return Subset(splits.train, range(len(splits.train)))  # type: ignore[arg-type]
        return Subset(splits.test, self.rest)
