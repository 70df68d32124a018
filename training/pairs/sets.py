"""A data set of pairs in its folder: which files it has, which command makes them, and with what
settings."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from moireaug.files import write_text
from training.system.files import read_json
from training.system.locks import locked

SHARE = re.compile(r"(\d+)/(\d+)")
WAIT = 60.0  # seconds for another command to write dataset.json
MOST_TOLD, LONGEST = 3, 24  # settings that differ, and characters of each, in a message
LIBRARIES = ("torch", "numpy", "numba", "pillow")


@dataclass(frozen=True)
class Share:
    """The part of the work that is this command's: number `index` of `of`, counted from 0."""

    index: int
    of: int

    @property
    def mark(self) -> str:
        """Return the share as a part of a file's name."""
        return f"{self.index}-of-{self.of}"


class PairSet(NamedTuple):
    """The files of a data set, all or in part, in their folder."""

    folder: Path
    n: int
    per_shard: int
    suffix: str

    def path(self, number: int) -> Path:
        """Return where a file lies."""
        return self.folder / f"{number:06d}{self.suffix}"

    def numbers(self, share: Share) -> list[int]:
        """Return the numbers of a share's files: every `share.of`-th."""
        count = -(-self.n // self.per_shard)
        return list(range(share.index, count, share.of))

    def missing(self, share: Share) -> list[int]:
        """Return the numbers of a share's files that are not there yet."""
        return [number for number in self.numbers(share) if not self.path(number).exists()]

    def pairs(self, number: int) -> range:
        """Return the numbers of the pairs in a file."""
        return range(number * self.per_shard, min((number + 1) * self.per_shard, self.n))


def share_of(shard: str) -> Share:
    """Return what `shard=i/n` says.

    Raises:
        ValueError: not two whole numbers with 0 <= i < n.
    """
    found = SHARE.fullmatch(shard)
    share = Share(int(found[1]), int(found[2])) if found else None
    if share is None or share.index >= share.of:
        raise ValueError(
            f"shard must be i/n with 0 <= i < n, the number of this command among n; got {shard}. "
            "It counts from 0: with Slurm, --array=0-15 and "
            "shard=$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT."
        )
    return share


def claim(out: Path, settings: dict[str, Any]) -> None:
    """Claim a folder for this data set, by its dataset.json.

    Raises:
        ValueError: it holds other files, or a data set with other settings, or another command
            holds it for too long.
        OSError: it cannot be written.
    """
    path = out / "dataset.json"
    out.mkdir(parents=True, exist_ok=True)
    with locked(out / ".dataset.lock", f"another command has held {out} for {WAIT:g} s.", WAIT):
        if not path.exists():
            if any(not other.name.startswith(".") for other in out.iterdir()):
                raise ValueError(
                    f"{out} holds files, but no dataset.json of this command: name a new folder."
                )
            made_with = {name: version(name) for name in LIBRARIES}
            write_text(path, json.dumps({"settings": settings, "made_with": made_with}, indent=1))
    there = (read_json(path) or {}).get("settings")
    if there is None:
        raise ValueError(f"{path} is damaged. Name a new folder, or restore the file.")
    told: list[str] = []
    for key, now in settings.items():
        told += _apart(there.get(key), now, key)
    if told:
        some = "; ".join(told[:MOST_TOLD]) + ("; ..." if len(told) > MOST_TOLD else "")
        raise ValueError(
            f"{out} holds a data set with other settings ({some}). Pass those in its dataset.json, "
            "or another out=DIR."
        )


def release(out: Path) -> None:
    """Give up a folder in which no file was begun, so that other settings can claim it."""
    path = out / "dataset.json"
    with locked(out / ".dataset.lock", f"another command has held {out} for {WAIT:g} s.", WAIT):
        others = [p for p in out.iterdir() if p != path and p.suffix != ".lock"]
        if not others:
            path.unlink(missing_ok=True)


def _apart(there: Any, now: Any, name: str) -> Iterator[str]:
    """Yield what differs between two settings, field by field."""
    if isinstance(there, dict) and isinstance(now, dict):
        for key in sorted(there.keys() | now.keys()):
            yield from _apart(there.get(key), now.get(key), f"{name}.{key}")
    elif there != now:
        yield f"{name}: {_short(there)} there, {_short(now)} now"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
