"""Records on disk, appended as they come: an evaluation that was interrupted goes on, and repeats nothing."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from moireaug.evaluation.sweep import Record


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; its folder is made where it is missing."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        unfinished.write_bytes(text.encode("utf-8", "replace"))  # a folder may name a class in no known encoding
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


class Store:
    """A folder of one JSON-lines file per process. Made for settings that do not change: a folder for each.

    Args:
        folder: made where it is missing.
        rank: of this process; each appends to a file of its own and reads all of them.
    """

    def __init__(self, folder: Path, rank: int = 0) -> None:
        self.folder, self.path = Path(folder), Path(folder) / f"records-{rank}.jsonl"
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.path.is_file():
            whole = self.path.read_bytes()
            torn = len(whole) - (whole.rfind(b"\n") + 1)
            if torn:  # a process that was killed while it wrote: its half line would spoil the next one
                os.truncate(self.path, len(whole) - torn)

    def records(self) -> list[Record]:
        """Everything that any process has written; the half line of one that is writing is left out."""
        found = []
        for path in sorted(self.folder.glob("records-*.jsonl")):
            lines = path.read_text(encoding="utf-8").split("\n")
            found += [json.loads(line) for line in lines[:-1] if line]
        return found

    def done(self) -> set[tuple[int, str, str]]:
        """The (place, rung, judge) that need not be done again."""
        return {(r["place"], r["rung"], r["judge"]) for r in self.records()}

    def append(self, records: Sequence[Record]) -> None:
        """Write records, all of them on the disk before this returns."""
        if records:
            with self.path.open("a", encoding="utf-8") as file:
                file.write("".join(json.dumps(r) + "\n" for r in records))
                file.flush()
                os.fsync(file.fileno())
