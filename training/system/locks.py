"""Locks between commands that work on the same folder."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

_NO_LOCKS = (
    errno.ENOSYS,
    errno.ENOLCK,
    errno.EOPNOTSUPP,
    errno.ENOTSUP,
)  # of a file system without locks


@contextlib.contextmanager
def locked(path: Path, busy: str, wait_seconds: float = 0) -> Iterator[None]:
    """Lock a file for this command; the kernel releases it however the command ends.

    Args:
        path: the lock's own file.
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
            if error.errno not in _NO_LOCKS:
                raise
        yield
