"""The cache of compiled kernels is never worse than none."""

import errno
import importlib.util
import multiprocessing
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from moireaug.engine.cpu import compiling, kernel_cache
from moireaug.engine.cpu.kernel_cache import KernelCache


def half(x):
    return x / 2


@pytest.fixture
def said(monkeypatch):
    """What users are told, in a process that has said nothing."""
    messages = []
    for module in (compiling, kernel_cache):
        monkeypatch.setattr(module, "warn_once", messages.append)
    monkeypatch.setattr(KernelCache, "is_full", False)
    return messages


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The folder that is written to, and one more to read from."""
    folders = {"folder": tmp_path / "kept", "other": tmp_path / "shipped"}
    for folder in folders.values():
        folder.mkdir()
    monkeypatch.setattr(compiling, "folder", lambda: str(folders["folder"]))
    monkeypatch.setattr(compiling, "other_folders", lambda: (str(folders["other"]),))
    return folders


def hits_and_misses(function=half):
    """Whether a new process, which `kernel` stands for, finds the kernel, and compiles it."""
    compiled = compiling.kernel(function)
    assert compiled(3.0) == 1.5
    return len(compiled.stats.cache_hits), len(compiled.stats.cache_misses)


def damage(suffix, change, folder):
    (path,) = folder.rglob(f"*{suffix}")
    path.write_bytes(change(path.read_bytes()))


CHANGES = {
    "empty": lambda kept: b"",
    "half": lambda kept: kept[: len(kept) // 2],
    "a bit": lambda kept: kept[:-20] + bytes([kept[-20] ^ 1]) + kept[-19:],
    "something else": lambda kept: b"<html>",
}


@pytest.mark.parametrize("suffix", [".nbc", ".nbi"])
@pytest.mark.parametrize("change", CHANGES)
def test_what_is_damaged_is_compiled_again_and_replaced(suffix, change, places, said):
    assert hits_and_misses() == (0, 1)
    assert hits_and_misses() == (1, 0)
    damage(suffix, CHANGES[change], places["folder"])
    assert hits_and_misses() == (0, 1)
    assert hits_and_misses() == (1, 0)
    assert set(said) == {kernel_cache.COMPILING_MESSAGE}


def test_copies_of_the_sources_share_their_kernels(places, said, tmp_path, monkeypatch):
    """As those of two environments do, or those of an image whose files have other times."""
    found = []
    for place in ("here", "there"):
        source = tmp_path / place / "halves.py"
        source.parent.mkdir()
        source.write_text("def half(x):\n    return x / 2\n")
        spec = importlib.util.spec_from_file_location("halves", source)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        monkeypatch.setitem(sys.modules, "halves", module)
        found.append(hits_and_misses(module.half))
    assert found == [(0, 1), (1, 0)]


def test_a_full_disk_costs_no_photo(places, said, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(kernel_cache._CheckedFile, "_open_for_write", refuse)
    assert hits_and_misses() == (0, 1)
    assert "(No space left on device): every process compiles them again" in said[-1]
    assert KernelCache.is_full
    monkeypatch.setattr(compiling, "FileLock", None)  # nobody waits for what will not be kept
    assert hits_and_misses() == (0, 1)


def test_a_folder_without_room_is_found_before_kernels_are_compiled(tmp_path, said, monkeypatch):
    assert kernel_cache.has_room(str(tmp_path)) and not list(tmp_path.iterdir())
    assert not kernel_cache.has_room(str(tmp_path / "gone"))
    assert KernelCache.is_full and "cannot be kept in" in said[0]


def test_kernels_that_came_with_an_image_are_read_where_they_are(places, said, monkeypatch):
    with monkeypatch.context() as built:
        built.setattr(compiling, "folder", lambda: str(places["other"]))
        built.setattr(compiling, "other_folders", lambda: ())
        assert hits_and_misses() == (0, 1)
    said.clear()
    assert hits_and_misses() == (1, 0)
    assert not said and not list(places["folder"].rglob("*.nb*"))


def test_a_place_that_cannot_be_written_to_is_read(tmp_path, monkeypatch):
    image, home = tmp_path / "image", tmp_path / "home"
    for parent in (image, home):
        parent.mkdir()
    filled = image / compiling._folder_name()
    filled.mkdir()
    (filled / "kernel.nbi").touch()
    monkeypatch.setattr(compiling, "_places", lambda: [filled, home / "kernels"])
    writable = compiling.os.access
    monkeypatch.setattr(
        compiling.os, "access", lambda path, mode: Path(path) != filled and writable(path, mode)
    )
    for function in (compiling.folder, compiling.other_folders):
        function.cache_clear()
    try:
        assert compiling.folder() == str(home / "kernels")
        assert compiling.other_folders() == (str(filled),)
        assert not compiling.is_cold()
    finally:
        for function in (compiling.folder, compiling.other_folders):
            function.cache_clear()


def hold(path, held, done):
    with FileLock(path):
        held.set()
        done.wait(60)


def test_a_wait_for_another_process_is_said_and_ends(places, said, monkeypatch):
    monkeypatch.setattr(compiling, "SILENT_SECONDS", 0.1)
    monkeypatch.setattr(compiling, "MAX_WAIT_SECONDS", 0.2)
    fork = multiprocessing.get_context("fork")
    held, done = fork.Event(), fork.Event()
    other = fork.Process(target=hold, args=(places["folder"] / "half.lock", held, done))
    other.start()
    held.wait(60)
    assert hits_and_misses() == (0, 1)  # the other one may never end
    assert said[0] == compiling.WAITING_MESSAGE
    said.clear()
    assert hits_and_misses() == (1, 0) and not said  # what is kept waits for nobody
    done.set()
    other.join(60)
