"""Files read as data: no code in them runs, damaged ones are refused; and folders that can be
written."""

import contextlib
import csv
import errno
import functools
import hashlib
import io
import itertools
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
import yaml
from filelock import FileLock, Timeout

MAX_SETTINGS_BYTES = 1_000_000  # of a config.yaml; fit.py writes about two thousand
MAX_REASON_CHARACTERS = 300  # of PyYAML's message
# of a file system without locks
NO_LOCKS_ERRORS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)


class PlainLoader(yaml.SafeLoader):
    """Reads YAML as `yaml.safe_load` does, but refuses aliases, which may grow without end."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return the next node, as PyYAML asks for it."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it holds a YAML alias: write the values out")
        return super().compose_node(parent, index)


def make_folder(path: Path, setting: str = "runs=DIR") -> None:
    """Make a folder and check that files can be written there, before time is spent.

    Args:
        setting: setting that names another folder, for the error messages.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(bytes(4096))
            file.flush()
    except (FileExistsError, NotADirectoryError):
        raise ValueError(
            f"{path} cannot be a folder: there is a file of that name, or of one above it. "
            f"Move it, or pass {setting}."
        ) from None
    except OSError as error:
        raise ValueError(
            f"{path} cannot be written ({error.strerror}): fix that, "
            f"or pass {setting} on another disk."
        ) from error


def require_outside(out: Path, folder: str, setting: str) -> None:
    """Refuse results in the folder that pictures are read from, where they would be read as some.

    Args:
        setting: setting that names that folder.
    """
    if out.resolve().is_relative_to(Path(folder).resolve()):
        raise ValueError(
            f"out={out} lies in {setting}={folder}, and what is written would be taken for "
            "pictures: pass out=DIR of a folder outside it."
        )


def has_parts(root: str | Path) -> bool:
    """Return whether a folder of images is split into train/ and test/: either alone may be the
    name of a class."""
    return all((Path(root) / part).is_dir() for part in ("train", "test"))


def free_name(path: Path) -> Path:
    """Return the path, with a number after its stem if it exists."""
    numbered = (path.with_name(f"{path.stem}-{k}{path.suffix}") for k in itertools.count(2))
    return next(name for name in itertools.chain([path], numbered) if not name.exists())


def read_table(path: Path) -> list[dict[str, Any]]:
    """Read the rows of a CSV file in UTF-8, with or without the mark that Excel puts first.

    Raises:
        OSError, ValueError, csv.Error: it cannot be read.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        return list(csv.DictReader(file))


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a Lightning checkpoint onto the CPU.

    Raises:
        ValueError: it is missing or damaged.
        OSError, MemoryError: it cannot be read now, and may be whole.
    """
    try:
        content = io.BytesIO(path.read_bytes())  # torch hides why it could not read a file
        checkpoint = torch.load(content, map_location="cpu", weights_only=True)
        checkpoint["epoch"]
        if not all(torch.is_tensor(value) for value in checkpoint["state_dict"].values()):
            raise TypeError("a value of its state_dict is no tensor")
        return checkpoint
    except Exception as error:  # by the damaged byte: UnpicklingError, EOFError, KeyError, ...
        is_missing = isinstance(error, (FileNotFoundError, NotADirectoryError))
        if isinstance(error, (OSError, MemoryError)) and not is_missing:
            raise
        raise ValueError(
            f"The checkpoint {path} could not be read ({type(error).__name__}). "
            "It may be missing or damaged: train again with resume=false, "
            "which moves what is there aside, or name another run."
        ) from error


def digest(path: str) -> str:
    """Return the SHA-256 of a file's bytes, which are read once as long as the file stays."""
    status = os.stat(path)
    return _digest(path, status.st_size, status.st_mtime_ns)


@functools.cache
def _digest(path: str, size: int, modified_ns: int) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_json(path: Path) -> dict[str, Any] | None:
    """Read a JSON file that holds a mapping; None where it is missing or damaged.

    Raises:
        OSError: it is there and cannot be read.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None


def read_settings(path: Path) -> dict[str, Any]:
    """Read the settings in a config.yaml: plain values, none looked up elsewhere.

    Raises:
        ValueError: no YAML mapping, or one with interpolations or aliases.
        OSError: a file that cannot be read.
    """
    if path.stat().st_size > MAX_SETTINGS_BYTES:
        raise ValueError(f"{path} is far too long for the settings of a run.")
    text = path.read_text(encoding="utf-8")
    try:
        values = yaml.load(text, PlainLoader)
        plain = json.dumps(values, default=str)
    except Exception as error:  # by the damaged byte: YAMLError, IndexError, AttributeError, ...
        reason = " ".join(str(error).split())[:MAX_REASON_CHARACTERS]
        raise ValueError(f"{path} could not be read as YAML: {reason}.") from error
    if "${" in plain:
        raise ValueError(
            f"{path} holds an interpolation (${{...}}). A run's settings are plain values, as "
            "fit.py writes them: write the values out."
        )
    if not isinstance(values, dict):
        raise ValueError(
            f"{path} holds no settings: it must be a YAML mapping, as fit.py writes it."
        )
    return values


@contextlib.contextmanager
def locked(path: Path, busy: str, wait_seconds: float = 0) -> Iterator[None]:
    """Lock a file for this command; the kernel releases it however the command ends.

    Args:
        busy: message of the error if another command holds the lock.
        wait_seconds: time to wait for that command; -1 is without end.

    Raises:
        ValueError: another command still holds it.
        OSError: the file cannot be opened or locked.
    """
    # a soft lock would outlive a killed command
    lock = FileLock(path, timeout=wait_seconds, fallback_to_soft=False)
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(lock)
        except Timeout:
            raise ValueError(busy) from None
        except OSError as error:
            if error.errno not in NO_LOCKS_ERRORS:
                raise
        yield
