"""The engine in threads and on a machine's first call."""

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from moireaug import Scene, capture, develop, expose
from moireaug.engine.cpu import compiling, first_use, run, threads
from moireaug.scene.by_name import with_values

SHOT = Scene.preset("screen_photo").sample(4, (16, 20), torch.Generator().manual_seed(0))
IMAGES = torch.rand(4, 3, 16, 20, generator=torch.Generator().manual_seed(1))


def test_threads_of_the_caller_see_the_same_photos():
    expected = capture(IMAGES, SHOT)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: capture(IMAGES, SHOT), range(4)))
    assert all(torch.equal(photos, expected) for photos in found)


@pytest.fixture(params=["OpenMP", "Python"])
def two_threads(request, monkeypatch):
    torch.set_num_threads(2)
    if request.param == "Python":  # as where PyTorch has no OpenMP
        monkeypatch.setattr(threads, "_openmp", lambda: None)
    elif threads._openmp() is None:
        pytest.skip("this PyTorch has no OpenMP's threads")
    else:
        monkeypatch.setattr(threads, "ThreadPoolExecutor", None)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("n", [0, 1, 2, 3, 50])
def test_every_part_is_done_once_by_two_threads(n):
    done, by = [], set()
    both = threading.Barrier(2)

    def work(first, last):
        done.extend(range(first, last))
        if threading.get_ident() not in by and n > 1:
            by.add(threading.get_ident())
            both.wait(20)  # until the other thread has a part, too

    threads.run_in_parts(work, n)
    assert sorted(done) == list(range(n))
    assert len(by) == (2 if n > 1 else 0)


SURPLUS = [  # threads, images, rows of each; images whose rows are shared
    (1, 1, 1000, 0), (2, 0, 1000, 0), (2, 1, 63, 0),  # too few rows to share
    (2, 1, 64, 1), (2, 16, 1000, 0),  # every thread has an image
    (2, 5, 1000, 1), (4, 3, 1000, 3), (4, 2, 100, 2),
    (4, 3, 100, 0),  # three parts of each would be no faster than an image per thread
]  # fmt: skip


def test_rows_are_shared_only_where_images_are_too_few():
    for count, n, rows, expected in SURPLUS:
        torch.set_num_threads(count)
        assert threads.surplus_images(n, rows) == expected, (count, n, rows)


@pytest.mark.parametrize("registered", [True, False])
@pytest.mark.parametrize("preset", ["screen_photo", "paper", "dashcam_at_led_sign"])
def test_sharing_an_images_rows_changes_no_bit(preset, registered, monkeypatch):
    scene, size = with_values(Scene.preset(preset), {"develop.registered": registered}), (131, 37)
    images = torch.rand(1, 3, *size, generator=torch.Generator().manual_seed(3))
    shot = scene.sample(1, size, torch.Generator().manual_seed(4))
    found, shared = [], []

    def spy(work, rows):
        shared.append(rows)
        threads.run_in_shares(work, rows)

    def unset(shape, dtype=float):
        out = np.zeros(shape, dtype)
        if out.dtype.kind == "f":
            out.fill(np.nan)
        return out

    # compiled before NumPy is changed, from which kernels take their own np.empty
    develop(expose(images, shot).requires_grad_(), shot).sum().backward()
    monkeypatch.setattr(run, "run_in_shares", spy)
    monkeypatch.setattr(np, "empty", unset)  # memory that nobody has written to
    for count in (1, 2, 3):
        torch.set_num_threads(count)
        raw = expose(images, shot).requires_grad_()
        photo = develop(raw, shot)
        (photo**2).sum().backward()
        found.append((raw.detach(), photo.detach(), raw.grad))
        assert bool(shared) == (count > 1)
    for others in found[1:]:
        for part, other in zip(found[0], others, strict=True):
            assert torch.equal(part, other)


@pytest.mark.usefixtures("two_threads")
def test_an_error_in_one_image_reaches_the_caller():
    def work(first, last):
        if first <= 3 < last:
            raise ValueError("the fourth")

    with pytest.raises(ValueError, match="the fourth"):
        threads.run_in_parts(work, 8)


def test_the_first_call_on_a_machine_compiles_ahead(tmp_path, monkeypatch):
    started, said = [], []
    monkeypatch.setattr(first_use, "warn_once", said.append)
    monkeypatch.setattr(compiling, "folder", lambda: str(tmp_path))
    monkeypatch.setattr(compiling, "other_folders", lambda: ())
    monkeypatch.setattr(first_use, "compile_ahead", started.append)
    first_use.prepare()
    assert started == [str(tmp_path)]
    (tmp_path / "kernel.nbi").touch()
    first_use.prepare()
    assert len(started) == 1 and not said
    monkeypatch.setattr(compiling, "folder", lambda: None)
    first_use.prepare()
    assert len(started) == 1
    assert "no place for them is writable: every process compiles them again" in said[0]


@pytest.fixture
def started(monkeypatch):
    """Record the commands of processes instead of starting them."""
    commands = []

    class Process:
        def __init__(self, command, **_):
            commands.append(command)

    monkeypatch.setattr(subprocess, "Popen", Process)
    monkeypatch.setattr(first_use.atexit, "register", lambda *_: None)
    return commands


def test_one_process_compiles_ahead_for_a_folder_of_kernels(tmp_path, started):
    first_use.compile_ahead(str(tmp_path))
    first_use.compile_ahead(str(tmp_path))
    assert [command[0] for command in started] == [sys.executable]


def test_nothing_is_compiled_ahead_where_it_cannot_be(tmp_path, started, monkeypatch):
    first_use.compile_ahead(str(tmp_path / "gone"))
    for program in ("/opt/game/game", "", None):  # which embeds Python
        monkeypatch.setattr(sys, "executable", program)
        first_use.compile_ahead(str(tmp_path))
    assert not started


def test_what_ended_early_is_compiled_ahead_again(tmp_path):
    marker = tmp_path / "ahead"
    marker.touch()
    first_use._stop(Mock(poll=lambda: 0), marker)
    assert marker.exists()
    for failed in (None, 1, -9):  # still at it, or ended by an error or a signal
        marker.touch()
        first_use._stop(Mock(poll=lambda failed=failed: failed), marker)
        assert not marker.exists()
