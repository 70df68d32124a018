"""Pairs as files: encoded pictures in a tar of WebDataset, or in a folder of Hugging Face
datasets."""

import csv
import io
import json
import os
import tarfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor
from torch.utils.data import Dataset

from moireaug.synthesis import Pair, Pairs
from training.data.codes import picture_of
from training.pairs.raw import npy_of, raw_metadata, reading_of

SUFFIXES = {"png": "png", "webp": "webp", "jpeg": "jpg"}  # by encoding
JPEG_QUALITY = 95
RAW_FILE = "raw.npy"


@dataclass(frozen=True)
class EncodedPair:
    """A pair as it is written.

    Args:
        files: content of its files, by their names ("photo.png").
        made_from: numbers that replay it, see `Pair.to_dict`; with a raw reading also `raw`, see
            `raw_metadata`.
        skipped: sentences on the pictures newly skipped as unusable.
    """

    index: int
    files: dict[str, bytes]
    made_from: dict[str, Any]
    skipped: list[str]

    @property
    def key(self) -> str:
        """Return the stem of its files' names."""
        return f"{self.index:06d}"


class EncodedPairs(Dataset):
    """Pairs by their numbers, encoded.

    Args:
        encoding: key of `SUFFIXES`.
        quality: quality, 1 to 100; None is lossless, and for JPEG 95.
        raw: whether to add the raw reading of each photo.
    """

    def __init__(self, pairs: Pairs, encoding: str, quality: int | None, raw: bool) -> None:
        self.pairs, self.encoding, self.quality, self.raw = pairs, encoding, quality, raw

    def __getitem__(self, k: int) -> EncodedPair:
        unusable = self.pairs.pictures.unusable
        known_count = len(unusable)
        pair = self.pairs.make_pair(k)
        files, made_from = encode_pair(pair, self.encoding, self.quality), pair.to_dict()
        if self.raw:
            reading = reading_of(pair)
            files[RAW_FILE] = npy_of(reading)
            made_from["raw"] = raw_metadata(pair.shot, reading)
        return EncodedPair(k, files, made_from, list(unusable.values())[known_count:])


def encode_pair(pair: Pair, encoding: str, quality: int | None) -> dict[str, bytes]:
    """Return the files of a pair's pictures by name ("photo.png"); arguments as in
    `EncodedPairs`."""
    files = {}
    for name, picture in pair.pictures().items():
        files[f"{name}.{SUFFIXES[encoding]}"] = encode(picture, encoding, quality)
    return files


def encode(picture: Tensor, encoding: str, quality: int | None) -> bytes:
    """Return the file of a picture (3, H, W) uint8; arguments as in `EncodedPairs`."""
    if encoding == "png":
        options: dict[str, Any] = {"compress_level": 1}  # a third of the time for 12 % more bytes
    elif encoding == "jpeg":
        # in full resolution: much of moiré is colour
        options = {"quality": quality or JPEG_QUALITY, "subsampling": "4:4:4"}
    elif quality is None:
        options = {"lossless": True, "method": 0}
    else:
        options = {"quality": quality}
    file = io.BytesIO()
    picture_of(picture).save(file, encoding, **options)
    return file.getvalue()


def write_tar(path: Path, pairs: Iterable[EncodedPair]) -> None:
    """Write a POSIX tar as WebDataset reads it: the files of a pair share their name up to the
    first dot. Its bytes depend on the pairs alone."""
    with path.open("wb") as file:
        with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
            for pair in pairs:
                numbers = json.dumps(pair.made_from).encode()
                for name, content in {**pair.files, "json": numbers}.items():
                    header = tarfile.TarInfo(f"{pair.key}.{name}")  # no owner, no time
                    header.size = len(content)
                    tar.addfile(header, io.BytesIO(content))
        file.flush()
        os.fsync(file.fileno())


def write_folder(path: Path, pairs: Iterable[EncodedPair]) -> None:
    """Write a folder of pictures and a metadata.csv, as `load_dataset("imagefolder")` reads it."""
    path.mkdir()
    table = io.StringIO()
    rows = None
    for pair in pairs:
        row = {}
        for name, content in pair.files.items():
            _write(path / f"{pair.key}.{name}", content)
            # what ends in file_name is read as a picture
            column = "raw_file" if name == RAW_FILE else f"{name.split('.')[0]}_file_name"
            row[column] = f"{pair.key}.{name}"
        for name, value in pair.made_from.items():
            row[name] = json.dumps(value) if isinstance(value, dict) else value
        if rows is None:
            rows = csv.DictWriter(table, list(row), lineterminator="\n")
            rows.writeheader()
        rows.writerow(row)
    _write(path / "metadata.csv", table.getvalue().encode("utf-8", "replace"))


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


class Format(NamedTuple):
    """A format of files: the suffix after the number in their names, and the function that writes
    one."""

    suffix: str
    write: Callable[[Path, Iterable[EncodedPair]], None]


FORMATS = {"webdataset": Format(".tar", write_tar), "imagefolder": Format("", write_folder)}
