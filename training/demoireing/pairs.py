"""Simulated pairs as tensors, for training, validation and testing."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.data import Dataset

from moireaug.mixtures import as_scene
from moireaug.scene.fields import bounds
from moireaug.scene.presets import MIXTURES
from moireaug.scenes import Scene
from moireaug.synthesis import without_moire
from moireaug.synthesis.pairs import Pair, check_aligned, make_pair, photo_of_codes
from moireaug.synthesis.pictures import Source
from training.data.codes import codes_of, picture_of, through_jpeg
from training.demoireing.pictures import EnlargedCrops, Splits
from training.demoireing.schema import DemoireConfig

COARSE_SIDE = 4  # pixels over which colour is averaged
# of pairs that are the same for every run; training draws others, unless these are its seed
VAL_SEED, TEST_SEED = 4_000_000_001, 4_000_000_002


def training_scenes(cfg: DemoireConfig) -> dict[str, Scene]:
    """Return the scenes that a run trains in, by their names."""
    listed = cfg.scene if isinstance(cfg.scene, (list, tuple)) else [cfg.scene]
    if not listed:
        raise ValueError("scene=[] names no scene: name at least one.")
    names: list[Any] = []
    for one in listed:
        names += MIXTURES[one] if isinstance(one, str) and one in MIXTURES else [one]
    scenes = {}
    for number, one in enumerate(names, 1):
        name = one if isinstance(one, str) else f"scene {number}"
        scene = as_scene(one)
        check_aligned(scene)
        scenes[name] = _of_crops(scene, cfg)
    return scenes


def _of_crops(scene: Scene, cfg: DemoireConfig) -> Scene:
    return scene if cfg.shrink is None else scene.with_shrink(cfg.shrink)


def enlarge_scene(scene: Scene, factor: int) -> Scene:
    """Return the scene for pictures of `factor` times the size that show the same: a pixel of a
    crop is then so many times smaller on the sensor."""
    if factor == 1 or not scene.is_crop:
        return scene
    low, high = bounds(scene.sensor.shrink)
    return scene.with_shrink((low / factor, high / factor))


class SimulatedPairs(Dataset):
    """Photos and their targets by number: (3, size, size) uint8 each; scenes take turns.

    Args:
        target: "clean", "twin" or "original".
        seed: seed of `moireaug.synthesis.Pairs`.
        subsample: photos are taken at one to this many times their size, in turn, and shrunk.
        jpeg: lowest quality at which photos are saved as JPEG, at random up to 100; None for none.
    """

    def __init__(
        self,
        pictures: Source,
        scenes: Sequence[Scene],
        size: int,
        target: str,
        seed: int,
        subsample: int = 1,
        jpeg: int | None = None,
    ) -> None:
        self.pictures, self.size, self.target = pictures, size, target
        self.seed, self.subsample, self.jpeg = seed, subsample, jpeg
        # a scene is planned once, and not for every pair
        factors = range(1, subsample + 1)
        self.scenes = [[enlarge_scene(scene, factor) for factor in factors] for scene in scenes]

    def pair(self, k: int) -> Pair:
        """Return a pair with all that is known of it, always with its twin and never shrunk."""
        return self._make(k, 1, twin=True)

    def __getitem__(self, k: int) -> tuple[Tensor, Tensor]:
        factor = 1 + k // len(self.scenes) % self.subsample
        pair = self._make(k, factor, twin=self.target == "twin")
        photo = shrink(pair.photo, factor, antialias=False)
        if self.jpeg is not None:
            quality = np.random.default_rng((self.seed, k)).integers(self.jpeg, 101)
            photo = codes_of(through_jpeg(picture_of(photo), int(quality)))
        return photo, shrink(self._target_of(pair), factor, antialias=True)

    def _make(self, k: int, factor: int, *, twin: bool) -> Pair:
        scene = self.scenes[k % len(self.scenes)][factor - 1]
        pictures, size = self.pictures, factor * self.size
        if factor > 1:
            pictures = EnlargedCrops(pictures, self.size, factor)
        return make_pair(k, pictures, scene, size, twin=twin, seed=self.seed)

    def _target_of(self, pair: Pair) -> Tensor:
        if self.target == "clean":
            return photo_of_codes(pair.original, without_moire(pair.shot, noise=False))
        return pair.pictures()[self.target]


class TurnedPairs(Dataset):
    """Pairs of strong moiré, made once, and served turned and mirrored: k and k + count are one
    pair in two orientations.

    Args:
        pairs: pairs to take them from. count: number of them.
        candidates: number of pairs, of which the one with the strongest moiré is taken.
    """

    def __init__(self, pairs: SimulatedPairs, count: int, candidates: int = 1) -> None:
        self.pairs, self.count, self.candidates = pairs, count, candidates
        self._pair_of: dict[int, tuple[Tensor, Tensor]] = {}

    def __getitem__(self, k: int) -> tuple[Tensor, Tensor]:
        orientation, number = divmod(k, self.count)
        if number not in self._pair_of:
            candidates = range(number, self.candidates * self.count, self.count)
            self._pair_of[number] = max(map(self.pairs.__getitem__, candidates), key=coarse_colour)
        turns, mirrored = orientation % 4, orientation // 4 % 2
        photo, target = (side.rot90(turns, (1, 2)) for side in self._pair_of[number])
        return (photo.flip(2), target.flip(2)) if mirrored else (photo, target)


def coarse_colour(pair: tuple[Tensor, Tensor]) -> float:
    """Return the strength of coarse colour in a photo that its target has not, in codes."""
    photo, target = pair
    error = photo.float() - target.float()
    return F.avg_pool2d(error[::2] - error[1], COARSE_SIDE).abs().mean().item()


def shrink(picture: Tensor, factor: int, *, antialias: bool) -> Tensor:
    """Shrink a picture (3, H, W) uint8 bilinearly, with a filter against moiré or without."""
    if factor == 1:
        return picture
    size = [length // factor for length in picture.shape[1:]]
    small = F.interpolate(picture[None].float(), size, mode="bilinear", antialias=antialias)
    return small[0].round().to(torch.uint8)


def test_pairs(cfg: DemoireConfig, splits: Splits) -> Mapping[str, SimulatedPairs]:
    """Return the pairs that a trained network is tested on, by the name of their scene: those that
    it was trained in come first."""
    scenes = training_scenes(cfg)
    for name in cfg.test.unseen:
        scenes[name] = _of_crops(as_scene(name), cfg)
    pairs_by_scene = {}
    for name, scene in scenes.items():
        pairs_by_scene[name] = SimulatedPairs(
            splits.test, [scene], cfg.test.size, cfg.demoire.target, TEST_SEED
        )
    return pairs_by_scene
