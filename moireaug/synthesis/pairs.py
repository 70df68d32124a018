"""Pairs: a crop of a picture, its photo off a screen and, if asked, the photo's twin without moiré.

Pair k takes its picture, its crop and its shot from a counter-based generator at (seed, k): it is
the same in any order, and by any number of processes.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from moireaug.capture import capture
from moireaug.common.argument_checks import check_whole
from moireaug.mixtures import Mixture, SceneLike, as_scenes, sample_one, scenes_of
from moireaug.scene.track import DEFAULT_HAND, track_of
from moireaug.scenes import Scene, Shot
from moireaug.synthesis.pictures import Pictures, Source
from moireaug.synthesis.twins import moire_codes, without_moire

SIZE_RANGE = (16, 8192)  # pixels a side
MAX_SEED = 2**32 - 1


@dataclass(frozen=True, eq=False)
class Pair:
    """A photo and its original, aligned pixel by pixel.

    Args:
        index: number k of the pair in the sequence of its seed.
        picture: name of the picture, relative to the folder.
        top, left: corner of the crop in the picture, in pixels.
        shot: shot of the photo, of one image, or of each frame of a video.
        original: (3, size, size) uint8, sRGB codes.
        photo: as the original; of a video (frames, 3, size, size).
        twin: photo by `without_moire(shot)`, or None.
    """

    index: int
    picture: str
    top: int
    left: int
    shot: Shot
    original: Tensor
    photo: Tensor
    twin: Tensor | None

    @property
    def moire(self) -> float | None:
        """Photo minus twin, in codes RMS, the mean over frames; None where there is no twin."""
        if self.twin is None:
            return None
        shape = (-1, *self.original.shape)
        photos, twins = self.photo.reshape(shape), self.twin.reshape(shape)
        return moire_codes(photos / 255, twins / 255).mean().item()

    def pictures(self) -> dict[str, Tensor]:
        """Return photo, original and, where there is one, twin."""
        pictures = {"photo": self.photo, "original": self.original}
        if self.twin is not None:
            pictures["twin"] = self.twin
        return pictures

    def to_dict(self) -> dict[str, Any]:
        """Return the pair's settings, and its `moire` where there is a twin, as plain values fit
        for JSON; `Shot.from_dict` of its `shot` takes the same photo again."""
        values = {name: getattr(self, name) for name in ("index", "picture", "top", "left")}
        values["shot"] = self.shot.to_dict()
        return values if self.twin is None else values | {"moire": self.moire}


class Pairs(IterableDataset):
    """Pairs of photographed pictures and their originals, made as they are asked for.

    Yields dicts of `photo`, `original` and, with `twin=True`, `twin`, (3, size, size) float32 in
    [0, 1], multiples of 1/255 as in a file; with `frames`, photo and twin are videos (frames, 3,
    size, size). And `index`, the pair's number: `make_pair` gives a pair by it, with the shot.
    Workers of a DataLoader and ranks of torch.distributed share the numbers out.

    Args:
        images: a folder of pictures, searched recursively. Those that are damaged or have a side
            below `size` are skipped: others are drawn in their place.
        scene: a Scene, a preset's name or a dict, or a list of these, a mixture: each pair is then
            photographed in one of them. Its photos must be registered.
        size: side of the crops, in pixels.
        twin: whether to photograph each crop again without moiré.
        seed: pair k is the same for the same seed, images, scene and size.
        n: number of pairs of an iteration, all processes together; None is without end. Every
            iteration begins with pair 0: take another seed for other pairs.
        shrink: the crops are parts of larger photos, with so many sensor pixels per pixel; None
            leaves the scene as it is, in presets a whole photo of each. See `Scene.with_shrink`.
        frames: of a video of each crop, filmed by hand as by `Scene.sample_track`; frame 0 is the
            photo that None, no video, takes.

    Raises:
        ValueError, TypeError: a folder without pictures, a scene in the camera's frame, a number
            out of its bounds.
    """

    def __init__(
        self,
        images: str | Path,
        scene: SceneLike,
        size: int,
        *,
        twin: bool = False,
        seed: int = 0,
        n: int | None = None,
        shrink: float | tuple[float, float] | None = None,
        frames: int | None = None,
    ) -> None:
        super().__init__()
        self.scene, self.twin = as_scenes(scene, shrink), twin
        check_whole("size", size, *SIZE_RANGE)
        check_whole("seed", seed, 0, MAX_SEED)
        if n is not None:
            check_whole("n", n, 1)
        if frames is not None:
            check_whole("frames", frames, 2)
        self.frames = frames
        self.size, self.seed, self.n = int(size), int(seed), None if n is None else int(n)
        check_aligned(self.scene)
        self.pictures = Pictures(images, self.size)
        self._rank, self._ranks = 0, 1

    def make_pair(self, k: int) -> Pair:
        """Return pair k >= 0. A pure function of k, the settings and the files.

        Raises:
            TypeError, ValueError: a k that is no whole number in [0, 2^63); no picture is usable,
                or the system could not read one.
        """
        check_whole("k", k, 0, 2**63 - 1)
        source, scene, size, seed = self.pictures, self.scene, self.size, self.seed
        twin, frames = self.twin, self.frames
        return make_pair(int(k), source, scene, size, twin=twin, seed=seed, frames=frames)

    def __getstate__(self) -> dict[str, Any]:
        """Keep the rank: a spawned worker of a DataLoader does not know its own."""
        rank, ranks = self._place()
        return vars(self) | {"_rank": rank, "_ranks": ranks}

    def _place(self) -> tuple[int, int]:
        """Return the rank of this process, or of the one that it was sent by, and how many ranks
        there are."""
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return torch.distributed.get_rank(), torch.distributed.get_world_size()
        return self._rank, self._ranks

    def __iter__(self) -> Iterator[dict[str, Any]]:
        rank, ranks = self._place()
        info = get_worker_info()
        worker, workers = (0, 1) if info is None else (info.id, info.num_workers)
        first, step = rank * workers + worker, ranks * workers
        numbers: Iterable[int] = itertools.count(first, step)
        if self.n is not None:
            numbers = range(first, self.n, step)
        for k in numbers:
            pictures = self.make_pair(k).pictures()
            yield {"index": k} | {name: codes.float() / 255 for name, codes in pictures.items()}


def make_pair(
    k: int,
    pictures: Source,
    scene: Scene | Mixture,
    size: int,
    *,
    twin: bool,
    seed: int,
    frames: int | None = None,
) -> Pair:
    """Return the pair of a number k >= 0: a picture, a crop of it and a shot, all drawn from (seed,
    k). Arguments as of `Pairs`; a scene, or mixture, that `check_aligned` accepts. Errors as of
    `pictures.draw`."""
    rng = np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, k]))
    name, picture = pictures.draw(rng)
    top = int(rng.integers(picture.height - size + 1))
    left = int(rng.integers(picture.width - size + 1))
    crop = picture.crop((left, top, left + size, top + size))
    original = torch.from_numpy(np.array(crop)).permute(2, 0, 1).contiguous()
    # of 32 bits, as torch keeps: about a hundred of a million shots come twice, of different crops
    generator = torch.Generator().manual_seed(int(rng.integers(2**32)))
    shot = sample_one(scene, (size, size), generator)
    if frames is not None:
        shot = track_of(shot, [frames], DEFAULT_HAND)
    photo = photo_of_codes(original, shot)
    twin_photo = photo_of_codes(original, without_moire(shot)) if twin else None
    return Pair(k, name, top, left, shot, original, photo, twin_photo)


@torch.no_grad()
def photo_of_codes(original: Tensor, shot: Shot) -> Tensor:
    """Return the photo of one picture (3, H, W), both uint8; by a shot of several frames, (frames,
    3, H, W)."""
    photos = capture((original[None].float() / 255).expand(len(shot), -1, -1, -1), shot)
    codes = (photos * 255).round().to(torch.uint8)
    return codes[0] if len(codes) == 1 else codes


def check_aligned(scene: Scene | Mixture) -> None:
    """Refuse scenes whose photos do not lie on their originals, or cannot be taken: ValueError."""
    for one in scenes_of(scene):
        if not one.develop.registered:
            raise ValueError(
                "pairs are aligned, and this scene leaves its photos in the camera's frame "
                "(develop.registered is false): pass one with Develop(registered=True)."
            )
        one.plan()  # refuses ranges that cannot be photographed
