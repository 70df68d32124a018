"""Simulated pairs as tensors for training, validation and testing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler, TensorDataset

from moireaug.scene.scene import Scene, as_scene
from moireaug.synthesis.pairs import Pair, check_aligned, make_pair
from moireaug.synthesis.pictures import Source
from moireaug.synthesis.tone import ColourMap
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig

# pairs that no training draws, whatever its seed: the same for every run
VAL_SEED, TEST_SEED = 4_000_000_001, 4_000_000_002
VAL_BATCH = 16


def scenes_of(cfg: DemoireConfig) -> dict[str, Scene]:
    """Return the scenes that a run trains in, by their names.

    Raises:
        TypeError, ValueError: no scene, or one whose photos are not aligned with their originals.
    """
    given = cfg.scene if isinstance(cfg.scene, (list, tuple)) else [cfg.scene]
    if not given:
        raise ValueError("scene=[] names no scene: name at least one.")
    found = {}
    for number, one in enumerate(given, 1):
        name = one if isinstance(one, str) else f"scene {number}"
        found[name] = as_scene(one)
        check_aligned(found[name])
    return found


class SimulatedPairs(Dataset):
    """Photos and their targets by number: (3, size, size) uint8 each; scenes take turns.

    Args:
        pictures: where their pictures come from. scenes: where they are photographed.
        size: side in pixels. target: "twin", "original" or "toned".
        seed: as of `moireaug.synthesis.Pairs`.
    """

    def __init__(
        self, pictures: Source, scenes: Sequence[Scene], size: int, target: str, seed: int
    ) -> None:
        self.pictures, self.scenes, self.size = pictures, tuple(scenes), size
        self.target, self.seed = target, seed

    def pair(self, k: int) -> Pair:
        """Return a pair with all that is known of it, always with its twin."""
        return self._made(k, twin=True)

    def __getitem__(self, k: int) -> tuple[Tensor, Tensor]:
        pair = self._made(k, twin=self.target == "twin")
        if self.target == "toned":
            return pair.photo, toned(pair.original, pair.photo)
        return pair.photo, pair.pictures()[self.target]

    def _made(self, k: int, *, twin: bool) -> Pair:
        scene = self.scenes[k % len(self.scenes)]
        return make_pair(k, self.pictures, scene, self.size, twin=twin, seed=self.seed)


def toned(original: Tensor, photo: Tensor) -> Tensor:
    """Return the original under the linear colour map that brings it closest to its photo: without
    moiré, noise, blur and shading, but with the photo's exposure and tint. All are (3, H, W) uint8.
    """
    codes, wanted = original.numpy().astype(np.float32), photo.numpy().astype(np.float32)
    mapped = ColourMap.fit(codes, wanted, squares=False)(codes)
    return torch.from_numpy(mapped.round().astype(np.uint8))


class Numbers(Sampler[int]):
    """The numbers of one rank's pairs in an epoch, different in every epoch.

    Args:
        count: pairs per epoch, of all ranks together.
    """

    def __init__(self, count: int, ranks: int, rank: int) -> None:
        self.count, self.ranks, self.rank, self.epoch = count, ranks, rank, 0

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch; Lightning calls it."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[int]:
        first = self.epoch * self.count
        return iter(range(first + self.rank, first + self.count, self.ranks))

    def __len__(self) -> int:
        return len(range(self.rank, self.count, self.ranks))


class PairBatches(L.LightningDataModule):
    """Serves pairs as loaders; the validation pairs are made once.

    Args:
        cfg: the run's settings. splits: its pictures. first: the epoch that training begins or
            resumes with.
    """

    def __init__(self, cfg: DemoireConfig, splits: Splits, first: int = 0) -> None:
        super().__init__()
        self.cfg, self.splits, self.first = cfg, splits, first
        self.scenes = list(scenes_of(cfg).values())

    def _pairs(self, pictures: Source, seed: int) -> SimulatedPairs:
        cfg = self.cfg
        return SimulatedPairs(pictures, self.scenes, cfg.data.size, cfg.demoire.target, seed)

    def train_dataloader(self) -> DataLoader:
        ranks, rank = (
            (self.trainer.world_size, self.trainer.global_rank) if self.trainer else (1, 0)
        )
        train, workers = self.cfg.train, self.cfg.data.workers
        size = max(1, train.batch_size // ranks)
        numbers = Numbers(train.check_every * size * ranks, ranks, rank)
        # Lightning starts the workers before it has read from which epoch training resumes
        numbers.set_epoch(self.first)
        return DataLoader(
            self._pairs(self.splits.train, self.cfg.seed),
            size,
            sampler=numbers,
            num_workers=workers,
            persistent_workers=workers > 0,
            multiprocessing_context="spawn" if workers else None,  # threads do not survive a fork
        )

    def val_dataloader(self) -> DataLoader:
        pairs = self._pairs(self.splits.val, VAL_SEED)
        made = [pairs[k] for k in range(self.cfg.data.val or 0)]
        photos, targets = (torch.stack(side) for side in zip(*made, strict=True))
        return DataLoader(TensorDataset(photos, targets), VAL_BATCH)


def test_pairs(cfg: DemoireConfig, splits: Splits) -> Mapping[str, SimulatedPairs]:
    """Return the pairs that a trained network is tested on, by the name of their scene: those that
    it was trained in come first."""
    scenes = scenes_of(cfg) | {name: as_scene(name) for name in cfg.test.unseen}
    found = {}
    for name, scene in scenes.items():
        found[name] = SimulatedPairs(
            splits.test, [scene], cfg.test.size, cfg.demoire.target, TEST_SEED
        )
    return found
