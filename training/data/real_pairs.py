"""Real pairs: photos of screens and the pictures on them, from files."""

import csv
import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from moireaug.common.files import shown
from moireaug.common.image_files import read_picture, size_of
from moireaug.synthesis.pictures import SUFFIXES, files_below
from training.data.codes import codes_of
from training.photographs.registration import register
from training.system.files import read_table

TABLE_NAME = "pairs.csv"  # of a folder


class PairFiles(NamedTuple):
    """The files of a photo and of the picture that it shows, aligned and of one size."""

    photo: Path
    original: Path


class ScreenPhoto(NamedTuple):
    """A photo (3, H, W) uint8, and the picture that it shows, aligned; None where it is unknown."""

    name: str
    photo: Tensor
    original: Tensor | None


def find_pairs(source: Path) -> list[PairFiles]:
    """Find the pairs of a CSV file with the columns photo and original, of a folder with such a
    file pairs.csv, or of one with the folders `photo` and `original`, paired by the files' stems.

    A CSV's relative paths are relative to its own folder."""
    if (source / TABLE_NAME).is_file():
        source = source / TABLE_NAME
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


def require_one_size(pair: PairFiles) -> None:
    """Refuse a photo of another size than its original, as their files say, before either is
    decoded."""
    photo, original = size_of(pair.photo), size_of(pair.original)
    if photo != original:
        sizes = ["{} x {}".format(*size) for size in (photo, original)]
        raise ValueError(
            f"{pair.photo} is {sizes[0]} and {pair.original} {sizes[1]} pixels: a pair must be "
            "aligned and of one size. With photos= and picture= photos are registered first."
        )


def fingerprint(pairs: Iterable[PairFiles]) -> str:
    """Return hex digits that change with the place, size or date of any file."""
    digest = hashlib.sha256()
    for pair in pairs:
        for path in pair:
            status = path.stat()
            line = f"{path.resolve()}\0{status.st_size}\0{status.st_mtime_ns}\n"
            digest.update(line.encode("utf-8", "surrogateescape"))
    return digest.hexdigest()[:16]


def _of_folders(root: Path) -> Iterator[PairFiles]:
    photos, originals = root / "photo", root / "original"
    by_name: dict[Path, list[Path]] = {}
    for original in find_images(originals):
        by_name.setdefault(original.relative_to(originals).with_suffix(""), []).append(original)
    for photo in find_images(photos):
        # a photo is often a JPEG, and its picture a PNG
        matches = by_name.get(photo.relative_to(photos).with_suffix(""), [])
        if not matches:
            raise ValueError(f"{photo} has no picture of the same name in {originals}.")
        if len(matches) > 1:
            raise ValueError(
                f"{photo} has more than one picture of its name: {matches[0]}, {matches[1]}."
            )
        yield PairFiles(photo, matches[0])


def _of_table(path: Path) -> Iterator[PairFiles]:
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
        yield PairFiles(path.parent / photo, path.parent / original)


def find_images(folder: Path) -> list[Path]:
    """Return the image files in a folder and below, in the order of their paths; hidden ones are
    skipped."""
    if not folder.is_dir():
        raise ValueError(f"the folder {folder} does not exist.")
    paths = sorted(folder / name for name in files_below(folder))
    return [path for path in paths if path.suffix.lower() in SUFFIXES]


def read_codes(path: Path) -> Tensor:
    """Return the codes of a picture, (3, H, W) uint8, upright."""
    return codes_of(read_picture(path))


def read_pairs(pairs: Iterable[PairFiles]) -> Iterator[ScreenPhoto]:
    """Read pairs one by one."""
    for pair in pairs:
        require_one_size(pair)
        photo, original = read_codes(pair.photo), read_codes(pair.original)
        yield ScreenPhoto(shown(pair.photo.stem), photo, original)


def read_registered(photos: Iterable[Path], picture: Path) -> Iterator[ScreenPhoto]:
    """Read photos of a screen that shows a picture, and register each to the picture; the parts of
    the picture that a photo does not show are cut off both."""
    on_screen = read_codes(picture)
    for path in photos:
        photo, original = register(read_codes(path), on_screen, str(path))
        yield ScreenPhoto(shown(path.stem), photo, original)
