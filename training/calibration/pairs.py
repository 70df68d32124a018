"""Real pairs, a photo of a screen and the picture on it, and the crops that are compared."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from moireaug import Scene, capture
from moireaug.images import read_picture, size_of
from moireaug.synthesis.pictures import SUFFIXES, files_below
from moireaug.synthesis.registration import register
from training.system.files import read_table

TABLE = "pairs.csv"  # of a folder
BATCH = 8  # crops that are photographed at a time


class Pair(NamedTuple):
    """The files of a photo and of the picture that it shows, aligned and of one size."""

    photo: Path
    original: Path


class Shown(NamedTuple):
    """A photo (3, H, W) uint8, and the picture that it shows, aligned; None where it is unknown."""

    name: str
    photo: Tensor
    original: Tensor | None


@dataclass(frozen=True, eq=False)
class Crops:
    """Crops at the same places of photos and originals.

    Args:
        photos: (N, 3, S, S) uint8.
        originals: the same of the originals; None where only photos are known.
        picture: (N,) int64, which picture a crop is of.
        names: of the pictures.
    """

    photos: Tensor
    originals: Tensor | None
    picture: Tensor
    names: tuple[str, ...]


def find_pairs(source: Path) -> list[Pair]:
    """Find the pairs of a CSV file with the columns photo and original, of a folder with such a
    file pairs.csv, or of one with the folders `photo` and `original`, paired by the files' stems.

    A CSV's relative paths are relative to its own folder.

    Raises:
        ValueError: none found, a column or a file that is missing.
    """
    if (source / TABLE).is_file():
        source = source / TABLE
    if source.is_dir():
        pairs = list(_of_folders(source))
    elif source.is_file():
        pairs = list(_of_table(source))
    else:
        raise ValueError(f"{source} is neither a CSV file nor a folder: name one that exists.")
    if not pairs:
        raise ValueError(
            f"no pairs in {source}. A CSV file has the columns photo and original and one line per "
            "pair; a folder holds the folders photo and original with files of the same names."
        )
    for pair in pairs:
        for path in (pair.photo, pair.original):
            if not path.is_file():
                raise ValueError(f"the picture {path}, named in {source}, does not exist.")
    return pairs


def require_one_size(pair: Pair) -> None:
    """Refuse a photo of another size than its original, as their files say, before either is
    decoded.

    Raises:
        ValueError: with both sizes, or a file that is no picture.
    """
    photo, original = size_of(pair.photo), size_of(pair.original)
    if photo != original:
        raise ValueError(_not_one_size(pair, photo, original))


def fingerprint(pairs: Iterable[Pair]) -> str:
    """Return hex digits that change with the place, size or date of any file."""
    digest = hashlib.sha256()
    for pair in pairs:
        for path in pair:
            known = path.stat()
            told = f"{path.resolve()}\0{known.st_size}\0{known.st_mtime_ns}\n"
            digest.update(told.encode("utf-8", "surrogateescape"))
    return digest.hexdigest()[:16]


def _of_folders(root: Path) -> Iterator[Pair]:
    photos, originals = root / "photo", root / "original"
    named: dict[Path, list[Path]] = {}
    for original in find_images(originals):
        named.setdefault(original.relative_to(originals).with_suffix(""), []).append(original)
    for photo in find_images(photos):
        # a photo is often a JPEG, and its picture a PNG
        same = named.get(photo.relative_to(photos).with_suffix(""), [])
        if not same:
            raise ValueError(f"{photo} has no picture of the same name in {originals}.")
        if len(same) > 1:
            raise ValueError(
                f"{photo} has more than one picture of its name: {same[0]}, {same[1]}."
            )
        yield Pair(photo, same[0])


def _of_table(path: Path) -> Iterator[Pair]:
    try:
        rows = read_table(path)
    except (OSError, ValueError, csv.Error) as error:
        raise ValueError(f"{path} could not be read as a CSV file in UTF-8 ({error}).") from error
    for number, row in enumerate(rows, 1):
        photo, original = row.get("photo"), row.get("original")
        if not photo or not original:
            raise ValueError(
                f"{path} must have the columns photo and original, filled in every line; row "
                f"{number} has {row}."
            )
        yield Pair(path.parent / photo, path.parent / original)


def find_images(folder: Path) -> list[Path]:
    """Return the image files in a folder and below, in the order of their paths; hidden ones are
    skipped.

    Raises:
        ValueError: no such folder, or one that may not be read.
    """
    if not folder.is_dir():
        raise ValueError(f"the folder {folder} does not exist.")
    paths = sorted(folder / name for name in files_below(folder))
    return [path for path in paths if path.suffix.lower() in SUFFIXES]


def read_codes(path: Path) -> Tensor:
    """Return the codes of a picture, (3, H, W) uint8, upright.

    Raises:
        ValueError: a file that cannot be read as one.
    """
    picture = read_picture(path)
    return torch.from_numpy(np.asarray(picture).copy()).permute(2, 0, 1)


def read_pairs(pairs: Iterable[Pair]) -> Iterator[Shown]:
    """Read pairs one by one.

    Raises:
        ValueError: a photo and its original differ in size.
    """
    for pair in pairs:
        photo, original = read_codes(pair.photo), read_codes(pair.original)
        if photo.shape != original.shape:
            sizes = [(p.shape[-1], p.shape[-2]) for p in (photo, original)]
            raise ValueError(_not_one_size(pair, *sizes))
        yield Shown(pair.photo.stem, photo, original)


def _not_one_size(pair: Pair, photo: tuple[int, int], original: tuple[int, int]) -> str:
    sizes = ["{} x {}".format(*size) for size in (photo, original)]
    return (
        f"{pair.photo} is {sizes[0]} and {pair.original} {sizes[1]} pixels: a pair must be aligned "
        "and of one size. With photos= and picture= photos are registered first."
    )


def cut(pictures: Iterable[Shown], side: int, each: int, seed: int = 0) -> Crops:
    """Cut `each` square crops of `side` pixels out of every picture, at random places.

    Args:
        pictures: all of them with originals, or none.

    Raises:
        ValueError: a picture that is smaller than a crop.
    """
    draw = np.random.default_rng(seed)
    photos: list[Tensor] = []
    originals: list[Tensor] = []
    index: list[int] = []
    names: list[str] = []
    for name, photo, original in pictures:
        height, width = photo.shape[-2:]
        if min(height, width) < side:
            raise ValueError(
                f"{name} is {_size(photo)} pixels, smaller than a crop of {side}: make the crops "
                "smaller."
            )
        for _ in range(each):
            y = int(draw.integers(0, height - side + 1))
            x = int(draw.integers(0, width - side + 1))
            # a view would keep the whole photo
            photos.append(photo[:, y : y + side, x : x + side].clone())
            index.append(len(names))
            if original is not None:
                originals.append(original[:, y : y + side, x : x + side].clone())
        names.append(name)
    both = torch.stack(originals) if originals else None
    return Crops(torch.stack(photos), both, torch.tensor(index, device="cpu"), tuple(names))


def _size(picture: Tensor) -> str:
    return f"{picture.shape[-1]} x {picture.shape[-2]}"


@torch.no_grad()
def photographed(scene: Scene, originals: Tensor, seed: int = 0) -> Tensor:
    """Photograph crops (N, 3, S, S) uint8 in a scene; return the photos as 8-bit codes of the same
    shape, as files hold them."""
    generator = torch.Generator().manual_seed(seed)
    height, width = originals.shape[-2:]
    shot = scene.sample(len(originals), (height, width), generator)
    photos = []
    for start in range(0, len(originals), BATCH):
        rows = slice(start, start + BATCH)
        photos.append(capture(originals[rows].float() / 255, shot[rows]))
    return (255 * torch.cat(photos)).round().clamp(0, 255).to(torch.uint8)


def registered(photos: Iterable[Path], picture: Path) -> Iterator[Shown]:
    """Read photos of a screen that shows a picture, and register each to the picture; the parts of
    the picture that a photo does not show are cut off both.

    Raises:
        ValueError: a photo in which the picture was not found.
    """
    shown = read_codes(picture)
    for path in photos:
        photo, original = register(read_codes(path), shown, str(path))
        yield Shown(path.stem, photo, original)
