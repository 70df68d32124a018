"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path

DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)  # a disk, or a user's share of it


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, as `shown` returns it; the rest as in `write_bytes`."""
    write_bytes(path, shown(text).encode())


def shown(name: str | Path) -> str:
    """Return a file's name, or a text with such names, as what tables and pages can hold: bytes
    that are not UTF-8, legal in a name, become "?"."""
    return str(name).encode("utf-8", "replace").decode()


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file whole or not at all: beside the old one, synced to the disk, then in its place.

    However it is interrupted, and however many threads, processes and machines write it at once,
    `path`, whose folder is made where it is missing, holds either the old content or one of the new
    ones. A process that is killed while it writes leaves a `.<name>.<random>.tmp` behind.

    Raises:
        OSError: the disk is full or not writable; says how many MB are needed and free.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_replacement(path) as beside, beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OSError(_sentence(path, len(data), error)) from error


@contextlib.contextmanager
def atomic_replacement(path: Path, mark: str = "") -> Iterator[Path]:
    """Yield a hidden path beside `path`, for a file or a folder that takes its place when the block
    ends, and is removed if the block fails.

    path: a file is replaced; a folder that exists by then is kept, and the new one dropped.
    mark: part of the hidden name, by which those of a killed process can be found.
    """
    # not a process id, which is the same in many containers; a name may have 255 bytes, of which a
    # character takes up to four
    words = [path.name[:40], mark, uuid.uuid4().hex[:16]]
    beside = path.with_name(f".{'.'.join(filter(None, words))}.tmp")
    try:
        yield beside
        if not (beside.is_dir() and path.is_dir()):  # else another command was first
            os.replace(beside, path)
    finally:
        remove(beside)


def remove(path: Path) -> None:
    """Remove a file, or a folder with its contents, if possible; never raises OSError."""
    with contextlib.suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def _sentence(path: Path, size: int, error: OSError) -> str:
    """Say why a file of `size` bytes could not be written, and what to do."""
    why = f"{path} could not be written ({error.strerror or error})"
    if error.errno not in DISK_FULL_ERRORS:
        return f"{why}. An older file there is still whole. Name a place that can be written."
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    free = shutil.disk_usage(folder).free / 1e6
    return (
        f"{why}: it needs {size / 1e6:.1f} MB, and {free:.1f} MB are free. An older file there is "
        "still whole. Make room, and run the same command again."
    )
