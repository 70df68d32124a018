"""The cache of compiled kernels on disk: numba's, made never worse than none.

What cannot be read, because it is damaged or half written, is compiled again; what cannot be
written, because a disk or quota is full, is compiled by each process for itself.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import pickle
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar

import numba
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)

CACHE_BYTES = 16 * 2**20  # twice as much as all kernels take
COMPILING_MESSAGE = (
    "moireaug compiles its CPU kernels, once on this machine; this takes one to several minutes."
)
NOT_KEPT_MESSAGE = (
    "moireaug's compiled CPU kernels cannot be kept{}: every process compiles them again, which "
    "takes it one to several minutes. Set NUMBA_CACHE_DIR to a folder that can be written to and "
    f"has {CACHE_BYTES >> 20} MiB of room."
)


class _Locator(UserProvidedCacheLocator):
    """The place of a kernel in a folder, which may be one that can only be read. The folder is of a
    hash of all sources: neither where they lie nor when they were written matters."""

    def __init__(self, py_func: FunctionType, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = numba.config.CACHE_DIR

    def get_source_stamp(self) -> str:
        return ""

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> _Locator:
        return cls(py_func, py_file)


class _Impl(CompileResultCacheImpl):
    _locator_classes: ClassVar = [_Locator]


class _CheckedFile(IndexDataCacheFile):
    """The files of a kernel; machine code is kept with its digest, and code that has another counts
    as absent."""

    def _load_index(self) -> dict:
        try:
            return super()._load_index()
        except Exception:  # whatever unpickling a damaged file may raise
            return {}

    def _save_data(self, name: str, data: Any) -> None:
        code = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(_digest(code) + code)

    def _load_data(self, name: str) -> Any:
        path = Path(self._data_path(name))
        kept = path.read_bytes()
        size = len(_digest(b""))
        if kept[:size] != _digest(kept[size:]):
            raise OSError(f"{path} is damaged")  # which numba takes for absent
        return pickle.loads(kept[size:])


def _digest(code: bytes) -> bytes:
    return hashlib.blake2b(code, digest_size=16).digest()


class _FolderCache(FunctionCache):
    """A kernel's cache in one folder."""

    _impl_class = _Impl

    def __init__(self, function: FunctionType, folder: str) -> None:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = folder
        try:
            super().__init__(function)
        finally:
            numba.config.CACHE_DIR = before
        self._cache_file: IndexDataCacheFile = _CheckedFile(
            self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # of another version of what is unpickled
            return None


class KernelCache(_FolderCache):
    """A kernel's cache in a folder that is written to and others that are only read.

    Args:
        function: what is compiled.
        folder: to read from and write to.
        others: further folders to read from.
    """

    is_full = False  # of any kernel, in this process

    def __init__(self, function: FunctionType, folder: str, others: Sequence[str] = ()) -> None:
        super().__init__(function, folder)
        self._others = [_FolderCache(function, other) for other in others]

    def is_kept(self, sig: Any, target_context: Any) -> bool:
        """Return whether a folder lists the kernel, which may yet be damaged."""
        key = self._index_key(sig, target_context.codegen())
        return any(key in cache._cache_file._load_index() for cache in (self, *self._others))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)
        for cache in self._others:
            if found is None:
                found = cache.load_overload(sig, target_context)
        if found is None and not KernelCache.is_full:
            warn_once(COMPILING_MESSAGE)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            self.report_full(self.cache_path, error)

    @classmethod
    def report_full(cls, folder: str, error: OSError) -> None:
        """Say that kernels cannot be written."""
        KernelCache.is_full = True
        warn_once(NOT_KEPT_MESSAGE.format(f" in {folder} ({error.strerror or error})"))


def has_room(folder: str) -> bool:
    """Return whether all kernels fit into a folder; say so if they do not.

    Free space does not tell, where a quota ends first: a file of their size is written, and
    removed.
    """
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            for _ in range(CACHE_BYTES >> 20):
                file.write(bytes(2**20))
            file.flush()
    except OSError as error:
        KernelCache.report_full(folder, error)
    return not KernelCache.is_full


@functools.cache
def warn_once(message: str) -> None:
    """Tell the user about kernels, each message once a process."""
    logging.getLogger("moireaug").warning(message)
