"""A data set of pairs in its folder: its files, their shares among commands, and its settings."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import moireaug
from moireaug.common.files import write_text
from training.system.files import locked, read_json

SHARE_PATTERN = re.compile(r"(\d+)/(\d+)")
MAX_WAIT_SECONDS = 60.0  # for another command to write dataset.json
# of a message on settings that differ
MAX_SHOWN_DIFFERENCES, MAX_VALUE_CHARACTERS = 3, 24
LIBRARIES = ("torch", "numpy", "numba", "pillow")


@dataclass(frozen=True)
class Share:
    """This command's share of the work: number `index` of `count`, counted from 0."""

    index: int
    count: int

    @property
    def label(self) -> str:
        """Return the share as a part of a file's name."""
        return f"{self.index}-of-{self.count}"


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
        """Return the numbers of a share's files: every `share.count`-th."""
        count = -(-self.n // self.per_shard)
        return list(range(share.index, count, share.count))

    def missing(self, share: Share) -> list[int]:
        """Return the numbers of a share's files that are not there yet."""
        return [number for number in self.numbers(share) if not self.path(number).exists()]

    def pairs(self, number: int) -> range:
        """Return the numbers of the pairs in a file."""
        return range(number * self.per_shard, min((number + 1) * self.per_shard, self.n))


def share_of(shard: str) -> Share:
    """Return the share of `shard=i/n`."""
    match = SHARE_PATTERN.fullmatch(shard)
    share = Share(int(match[1]), int(match[2])) if match else None
    if share is None or share.index >= share.count:
        raise ValueError(
            f"shard must be i/n with 0 <= i < n, the number of this command among n; got {shard}. "
            "It counts from 0: with Slurm, --array=0-15 and "
            "shard=$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT."
        )
    return share


def claim(out: Path, settings: dict[str, Any]) -> None:
    """Claim a folder for this data set, by its dataset.json.

    Raises:
        ValueError: it holds other files, or a data set with other settings or by another version of
            moireaug, or another command holds it for too long.
        OSError: it cannot be written.
    """
    path = out / "dataset.json"
    out.mkdir(parents=True, exist_ok=True)
    busy = f"another command has held {out} for {MAX_WAIT_SECONDS:g} s."
    with locked(out / ".dataset.lock", busy, MAX_WAIT_SECONDS):
        if not path.exists():
            if any(not other.name.startswith(".") for other in out.iterdir()):
                raise ValueError(
                    f"{out} holds files, but no dataset.json of this command: name a new folder."
                )
            made_with = {name: version(name) for name in LIBRARIES}
            made_with["moireaug"] = moireaug.__version__
            write_text(path, json.dumps({"settings": settings, "made_with": made_with}, indent=1))
    content = read_json(path) or {}
    stored = content.get("settings")
    if stored is None:
        raise ValueError(f"{path} is damaged. Name a new folder, or restore the file.")
    made_by = content.get("made_with", {}).get("moireaug", moireaug.__version__)
    if made_by != moireaug.__version__:
        raise ValueError(
            f"{out} holds a data set that moireaug {made_by} has begun, and this is "
            f"{moireaug.__version__}, whose photos may differ: install {made_by} to continue it, "
            "or pass another out=DIR."
        )
    differences: list[str] = []
    for key, current in settings.items():
        differences += _differences(stored.get(key), current, key)
    if differences:
        text = "; ".join(differences[:MAX_SHOWN_DIFFERENCES])
        if len(differences) > MAX_SHOWN_DIFFERENCES:
            text += "; ..."
        raise ValueError(
            f"{out} holds a data set with other settings ({text}). Pass those in its dataset.json, "
            "or another out=DIR."
        )


def _differences(stored: Any, current: Any, name: str) -> Iterator[str]:
    """Yield the differences between two settings, field by field."""
    if isinstance(stored, dict) and isinstance(current, dict):
        for key in sorted(stored.keys() | current.keys()):
            yield from _differences(stored.get(key), current.get(key), f"{name}.{key}")
    elif stored != current:
        yield f"{name}: {_shortened(stored)} there, {_shortened(current)} now"


def _shortened(value: Any) -> str:
    text = str(value)
    return text if len(text) <= MAX_VALUE_CHARACTERS else f"{text[:MAX_VALUE_CHARACTERS]}..."
