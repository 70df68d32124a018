"""Records: one line per finished piece, appended as it comes. An evaluation that was stopped
repeats nothing.

A record's key is a digest of its settings: the model's weights, the batch's pixels and labels, the
scene, the condition's settings, the classifier and the seed. Every suite reuses the records of
others.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
from filelock import BaseFileLock, FileLock, Timeout
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from torch import Tensor

from moireaug.common.files import write_bytes

Record = dict[str, Any]
RECORD_FIELDS = {"key", "labels", "targets", "predicted", "measured", "seconds"}
N_PICTURES = 4  # images of the first batch that are saved as pictures


class Records:
    """Records in memory, by key."""

    def __init__(self) -> None:
        self._records: dict[str, Record] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close and unlock the file of records, where there is one."""

    def __contains__(self, key: str) -> bool:
        return key in self._records

    def __getitem__(self, key: str) -> Record:
        return self._records[key]

    def __len__(self) -> int:
        return len(self._records)

    def append(self, records: Sequence[Record]) -> None:
        """Keep records."""
        for record in records:
            self._records[record["key"]] = record

    def keep_picture(self, name: str, images: Tensor) -> None:
        """Save the images of a condition in the first batch; records in memory save none."""

    def picture(self, name: str) -> np.ndarray | None:
        """Return the saved images, (n, H, W, 3) uint8; None where there are none."""
        return None

    def read(self) -> None:
        """Read the records that other processes have written meanwhile."""


class RecordFolder(Records):
    """Records in a folder of JSON-lines files, one per process that writes, to be used in a `with`.

    Args:
        folder: created at the first record if missing. Every process appends to its own file and
            reads all.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = Path(folder)
        self._file: IO[bytes] | None = None
        self._lock: BaseFileLock | None = None
        self.read()

    def __exit__(self, *_: object) -> None:
        file, lock = self._file, self._lock
        self._file = self._lock = None
        try:
            if file is not None:
                file.close()
        finally:
            if lock is not None:
                lock.release()

    def _writable_file(self) -> IO[bytes]:
        """Return the first file that no other process writes, locked and open for appending."""
        if self._file is not None:
            return self._file
        self.folder.mkdir(parents=True, exist_ok=True)
        for number in itertools.count():
            path = self.folder / f"records-{number}.jsonl"
            lock = FileLock(self.folder / f".records-{number}.lock", blocking=False)
            try:
                lock.acquire()
            except Timeout:
                continue
            break
        _end_last_line(path)
        self._lock = lock
        self._file = path.open("ab")
        return self._file

    def read(self) -> None:
        """Read the records of all processes. A line that cannot be read, because a process is
        writing it or a disk was full, is left out: its record is computed again.

        Raises:
            ValueError: records that do not say what an eps counts, of another version.
        """
        for path in sorted(self.folder.glob("records-*.jsonl")):
            records = []
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
                with contextlib.suppress(ValueError):
                    record = json.loads(line)
                    if isinstance(record, dict) and record.keys() >= RECORD_FIELDS:
                        records.append(record)
            if not all("bound" in record for record in records):
                raise ValueError(
                    f"{path} has records that do not say what their eps counts, codes or light: "
                    "another version of this project wrote them. Delete or move that file, or "
                    "choose another folder, and attack again."
                )
            super().append(records)

    def append(self, records: Sequence[Record]) -> None:
        """Write records, all of them on the disk before this returns."""
        if not records:
            return
        lines = [json.dumps(record) + "\n" for record in records]
        file = self._writable_file()
        file.write("".join(lines).encode())
        file.flush()
        os.fsync(file.fileno())
        super().append(records)

    def keep_picture(self, name: str, images: Tensor) -> None:
        """Save the first images of a batch (B, 3, H, W) in [0, 1], one below the other in one
        PNG."""
        pictures = (images[:N_PICTURES].detach().float().cpu() * 255).round().byte()
        rows = pictures.permute(0, 2, 3, 1).reshape(-1, pictures.shape[3], 3).numpy()
        text = PngInfo()
        text.add_text("images", str(len(pictures)))
        file = io.BytesIO()
        Image.fromarray(rows).save(file, "PNG", pnginfo=text)
        write_bytes(self._picture_path(name), file.getvalue())

    def picture(self, name: str) -> np.ndarray | None:
        path = self._picture_path(name)
        if not path.is_file():
            return None
        with Image.open(path) as image:
            rows = np.asarray(image.convert("RGB"))
            n = int(image.info["images"])
        return rows.reshape(n, len(rows) // n, -1, 3)

    def _picture_path(self, name: str) -> Path:
        return self.folder / "pictures" / f"{name}.png"


def _end_last_line(path: Path) -> None:
    """Cut off the incomplete line of a process that was killed while it wrote."""
    if not path.is_file():
        return
    text = path.read_bytes()
    if not text.endswith(b"\n"):
        os.truncate(path, text.rfind(b"\n") + 1)
