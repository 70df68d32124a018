"""Records on disk, appended as they come: an evaluation that was interrupted goes on, and repeats nothing."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Sequence
from pathlib import Path

from moireaug.evaluation.sweep import Record

try:
    import fcntl
except ImportError:  # Windows, where nothing is locked
    fcntl = None  # type: ignore[assignment]


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; its folder is made where it is missing."""
    write_bytes(path, text.encode("utf-8", "replace"))  # a folder may name a class in no known encoding


def write_bytes(path: Path, data: bytes) -> None:
    """The same for what is no text."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        unfinished.write_bytes(data)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


class Store:
    """A folder of one JSON-lines file per process, to be used in a `with`. Made for settings that do not change: a
    folder for each.

    Args:
        folder: made where it is missing.
        rank: of this process; each appends to a file of its own and reads all of them.

    Raises:
        ValueError: another process writes the same file.
    """

    def __init__(self, folder: Path, rank: int = 0) -> None:
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"records-{rank}.jsonl"
        self.file = path.open("a+b")
        try:
            if fcntl:
                fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.file.close()
            raise ValueError(
                f"{path} is being written by another process: wait for it, or give other settings."
            ) from None
        whole = path.read_bytes()
        if not whole.endswith(b"\n"):  # of a process that was killed while it wrote: the next line starts anew
            os.truncate(path, whole.rfind(b"\n") + 1)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def records(self) -> list[Record]:
        """Everything that any process has written. A line that cannot be read, because a process is writing it or a
        disk was full, is left out: what it held is computed again."""
        found = []
        for path in sorted(self.folder.glob("records-*.jsonl")):
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
                with contextlib.suppress(ValueError):
                    found.append(json.loads(line))
        return found

    def done(self) -> set[tuple[int, str, str]]:
        """The (place, rung, judge) that need not be done again."""
        return {(r["place"], r["rung"], r["judge"]) for r in self.records()}

    def append(self, records: Sequence[Record]) -> None:
        """Write records, all of them on the disk before this returns."""
        if records:
            self.file.write("".join(json.dumps(r) + "\n" for r in records).encode())
            self.file.flush()
            os.fsync(self.file.fileno())
