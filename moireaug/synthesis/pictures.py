"""The pictures that pairs are made from: found in a folder, drawn, and skipped where unusable."""

from __future__ import annotations

import copy
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image

from moireaug.common.image_files import read_picture

# of a picture's file, in every command; .jfif is what browsers name a JPEG
SUFFIXES = (".jpg", ".jpeg", ".jfif", ".png", ".ppm", ".bmp", ".pgm", ".tif", ".tiff", ".webp")


class Source(Protocol):
    """A source of pictures for pairs."""

    def draw(self, rng: np.random.Generator) -> tuple[str, Image.Image]:
        """Draw a picture; return its name and the picture, in mode RGB. A pure function of
        `rng`."""
        ...


class NoPictureError(ValueError):
    """A folder without a usable picture."""


class Pictures:
    """The picture files of a folder and of those inside it, in the order of their names.

    Names that begin with a dot are skipped. `others` holds the files without an image suffix, and
    `unusable` the reason for each picture that `draw` has skipped so far.

    min_side: smallest side of a usable picture, in pixels.

    Raises:
        ValueError: no folder, or no picture in it.
    """

    def __init__(self, folder: str | Path, min_side: int) -> None:
        self.folder, self.min_side = Path(folder), min_side
        self.unusable: dict[int, str] = {}
        if not self.folder.is_dir():
            raise ValueError(f"{self.folder} is not a folder: pass one with pictures inside.")
        files = files_below(self.folder)
        self.names = [name for name in files if name.lower().endswith(SUFFIXES)]
        self.others = [name for name in files if not name.lower().endswith(SUFFIXES)]
        if not self.names:
            raise ValueError(
                f"{self.folder} holds no pictures: none of its {len(self.others)} files ends with "
                f"{', '.join(SUFFIXES)}."
            )

    def __len__(self) -> int:
        return len(self.names)

    def draw(self, rng: np.random.Generator) -> tuple[str, Image.Image]:
        """Draw pictures, each with the same probability, until one is usable; return its name and
        the picture. The result depends on `rng` and the files alone, not on earlier draws.

        Raises:
            ValueError: the system could not read one; a NoPictureError, none is usable.
        """
        while len(self.unusable) < len(self):
            index = int(rng.integers(len(self)))
            picture = None if index in self.unusable else self._load(index)
            if picture is not None:
                return self.names[index], picture
        first = next(iter(self.unusable.values()))
        raise NoPictureError(
            f"none of the {len(self)} pictures in {self.folder} is usable. The first: {first}"
        )

    def subset(self, numbers: Sequence[int]) -> Pictures:
        """Return some of the pictures, by their numbers, as if the folder held no others."""
        pictures = copy.copy(self)
        pictures.names = [self.names[number] for number in numbers]
        pictures.unusable = {}
        return pictures

    def fingerprint(self) -> str:
        """Return hex digits that change with any picture's name or number of bytes."""
        digest = hashlib.sha256()
        for name in self.names:
            size = (self.folder / name).stat().st_size
            digest.update(name.encode("utf-8", "surrogateescape") + f"\0{size}\n".encode())
        return digest.hexdigest()

    def _load(self, index: int) -> Image.Image | None:
        """Return a picture, or None, and keep the reason in `unusable`."""
        path = self.folder / self.names[index]
        try:
            picture = read_picture(path)
        except ValueError as error:
            # a disk that fails now may work on another machine: no reason to take another picture
            cause = error.__cause__
            if isinstance(cause, MemoryError) or (isinstance(cause, OSError) and cause.errno):
                raise
            self.unusable[index] = str(error)
            return None
        if min(picture.size) >= self.min_side:
            return picture
        width, height = picture.size
        self.unusable[index] = (
            f"The image {path} is too small: {width} x {height} pixels, and the crops have "
            f"{self.min_side} x {self.min_side}."
        )
        return None


def _unreadable(error: OSError) -> None:
    raise ValueError(
        f"the folder {error.filename} could not be read ({error.strerror}): allow it, or move the "
        "folder elsewhere."
    ) from error


def files_below(folder: Path) -> list[str]:
    """Return the names of all files below a folder, relative to it, in order, except hidden ones
    and links to nothing. A folder that links lead back to is read once; one that may not be read is
    refused: ValueError."""
    names, visited = [], set()
    for parent, folders, files in os.walk(folder, onerror=_unreadable, followlinks=True):
        place = os.path.realpath(parent)
        if place in visited:
            folders.clear()
            continue
        visited.add(place)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in files:
            path = Path(parent, name)
            if not name.startswith(".") and path.exists():
                names.append(path.relative_to(folder).as_posix())
    return sorted(names)
