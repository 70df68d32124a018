"""Simulated pairs as tensors, for training, validation and testing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from moireaug.scene.presets import MIXTURES
from moireaug.scenes import Scene, as_scene
from moireaug.synthesis.pairs import Pair, check_aligned, make_pair
from moireaug.synthesis.pictures import Source
from moireaug.synthesis.tone import ColourMap
from training.demoireing.pictures import Splits
from training.demoireing.schema import DemoireConfig

# pairs that no training draws, whatever its seed: the same for every run
VAL_SEED, TEST_SEED = 4_000_000_001, 4_000_000_002


def scenes_of(cfg: DemoireConfig) -> dict[str, Scene]:
    """Return the scenes that a run trains in, by their names.

    Raises:
        TypeError, ValueError: no scene, or one whose photos are not aligned with their originals.
    """
    listed = cfg.scene if isinstance(cfg.scene, (list, tuple)) else [cfg.scene]
    if not listed:
        raise ValueError("scene=[] names no scene: name at least one.")
    names: list[Any] = []
    for one in listed:
        names += MIXTURES[one] if isinstance(one, str) and one in MIXTURES else [one]
    scenes = {}
    for number, one in enumerate(names, 1):
        name = one if isinstance(one, str) else f"scene {number}"
        scenes[name] = as_scene(one)
        check_aligned(scenes[name])
    return scenes


class SimulatedPairs(Dataset):
    """Photos and their targets by number: (3, size, size) uint8 each; scenes take turns.

    Args:
        pictures: source of their pictures.
        scenes: scenes that photograph them.
        size: side of a pair, in pixels.
        target: "twin", "original" or "toned".
        seed: seed of `moireaug.synthesis.Pairs`.
    """

    def __init__(
        self, pictures: Source, scenes: Sequence[Scene], size: int, target: str, seed: int
    ) -> None:
        self.pictures, self.scenes, self.size = pictures, tuple(scenes), size
        self.target, self.seed = target, seed

    def pair(self, k: int) -> Pair:
        """Return a pair with all that is known of it, always with its twin."""
        return self._make(k, twin=True)

    def __getitem__(self, k: int) -> tuple[Tensor, Tensor]:
        pair = self._make(k, twin=self.target == "twin")
        if self.target == "toned":
            return pair.photo, tone_to(pair.original, pair.photo)
        return pair.photo, pair.pictures()[self.target]

    def _make(self, k: int, *, twin: bool) -> Pair:
        scene = self.scenes[k % len(self.scenes)]
        return make_pair(k, self.pictures, scene, self.size, twin=twin, seed=self.seed)


def tone_to(original: Tensor, photo: Tensor) -> Tensor:
    """Return the original under the linear colour map that brings it closest to its photo: without
    moiré, noise, blur and shading, but with the photo's exposure and tint. All are (3, H, W) uint8.
    """
    codes, target = original.numpy().astype(np.float32), photo.numpy().astype(np.float32)
    mapped = ColourMap.fit(codes, target, squares=False)(codes)
    return torch.from_numpy(mapped.round().astype(np.uint8))


def test_pairs(cfg: DemoireConfig, splits: Splits) -> Mapping[str, SimulatedPairs]:
    """Return the pairs that a trained network is tested on, by the name of their scene: those that
    it was trained in come first."""
    scenes = scenes_of(cfg) | {name: as_scene(name) for name in cfg.test.unseen}
    pairs_by_scene = {}
    for name, scene in scenes.items():
        pairs_by_scene[name] = SimulatedPairs(
            splits.test, [scene], cfg.test.size, cfg.demoire.target, TEST_SEED
        )
    return pairs_by_scene
