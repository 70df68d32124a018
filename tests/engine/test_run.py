"""The engine in workers, threads and on a machine's first call."""

import dataclasses
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from moireaug import Scene, View, capture, develop, expose
from moireaug.engine import ahead, compiling, explain, reference, run, threads

SHOT = Scene.preset("screen_photo").sample(4, (16, 20), torch.Generator().manual_seed(0))
IMAGES = torch.rand(4, 3, 16, 20, generator=torch.Generator().manual_seed(1))


def photos(rows=slice(None)):
    return capture(IMAGES[rows], SHOT[rows])


class Photos(Dataset):
    def __len__(self):
        return len(IMAGES)

    def __getitem__(self, i):
        torch.set_num_threads(2)
        return photos([i, i])[0]


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_workers_see_the_same_photos(start):
    torch.set_num_threads(2)
    expected = photos()  # threads have run in this process before it forks
    loader = DataLoader(Photos(), batch_size=2, num_workers=1, multiprocessing_context=start)
    assert torch.equal(torch.cat(list(loader)), expected)


def test_threads_of_the_caller_see_the_same_photos():
    expected, found = photos(), {}

    def work(i):
        found[i] = photos()

    callers = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    for i in range(4):
        assert torch.equal(found[i], expected)


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
@pytest.mark.parametrize("n", [0, 1, 2, 3, 8, 50])
def test_every_part_is_done_once_by_two_threads(n):
    done, by = [], set()
    both = threading.Barrier(2)

    def work(first, last):
        done.extend(range(first, last))
        if threading.get_ident() not in by and n > 1:
            by.add(threading.get_ident())
            both.wait(20)  # until the other thread has a part, too

    threads.each(work, n)
    assert sorted(done) == list(range(n))
    assert len(by) == (2 if n > 1 else 0)


@pytest.mark.parametrize(
    ("threads_of_torch", "n", "rows", "expected"),
    [
        (1, 1, 1000, 0),
        (2, 0, 1000, 0),
        (2, 1, 63, 0),  # too few rows to share
        (2, 1, 64, 1),
        (2, 16, 1000, 0),  # every thread has an image
        (2, 5, 1000, 1),
        (4, 3, 1000, 3),
        (4, 3, 100, 0),  # three parts of each would be no faster than an image per thread
        (4, 2, 100, 2),
    ],
)
def test_rows_are_shared_only_where_images_are_too_few(threads_of_torch, n, rows, expected):
    torch.set_num_threads(threads_of_torch)
    assert threads.surplus(n, rows) == expected


@pytest.mark.parametrize("frame", ["the image's", "the camera's"])
@pytest.mark.parametrize("preset", ["screen_photo", "paper", "dashcam_at_led_sign"])
@pytest.mark.parametrize("size", [(131, 37), (64, 50)])
def test_sharing_an_images_rows_changes_no_bit(preset, frame, size, monkeypatch):
    scene = Scene.preset(preset)
    made = dataclasses.replace(scene.develop, registered=frame == "the image's")
    scene = dataclasses.replace(scene, develop=made)
    images = torch.rand(1, 3, *size, generator=torch.Generator().manual_seed(3))
    shot = scene.sample(1, size, torch.Generator().manual_seed(4))
    found, shared = [], []

    def spy(work, rows):
        shared.append(rows)
        threads.each_share(work, rows)

    def unset(shape, dtype=float):
        out = np.zeros(shape, dtype)
        if out.dtype.kind == "f":
            out.fill(np.nan)
        return out

    # compiled before NumPy is changed, from which kernels take their own np.empty
    develop(expose(images, shot).requires_grad_(), shot).sum().backward()
    monkeypatch.setattr(run, "each_share", spy)
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
        threads.each(work, 8)


def test_the_first_call_on_a_machine_is_announced_once(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr(run, "announce", said.append)
    monkeypatch.setattr(compiling, "folder", lambda: str(tmp_path))
    monkeypatch.setattr(ahead, "start", lambda folder: said.append(folder))
    run.prepare.cache_clear()
    run.prepare()
    run.prepare()
    assert len(said) == 2
    assert "compiles" in said[0]
    assert said[1] == str(tmp_path)
    (tmp_path / "kernel.nbi").touch()
    run.prepare.cache_clear()
    run.prepare()
    assert len(said) == 2


@pytest.fixture
def started(monkeypatch):
    """Record the commands of processes instead of starting them."""
    commands = []

    class Process:
        def __init__(self, command, **_):
            commands.append(command)

    monkeypatch.setattr(subprocess, "Popen", Process)
    monkeypatch.setattr(ahead.atexit, "register", lambda *_: None)
    return commands


def test_one_process_compiles_ahead_for_a_folder_of_kernels(tmp_path, started):
    ahead.start(str(tmp_path))
    ahead.start(str(tmp_path))
    assert [command[0] for command in started] == [sys.executable]


@pytest.mark.parametrize("program", ["/opt/game/game", "", None])
def test_nothing_is_compiled_ahead_by_a_program_that_embeds_python(
    tmp_path, started, monkeypatch, program
):
    monkeypatch.setattr(sys, "executable", program)
    ahead.start(str(tmp_path))
    assert not started


def test_nothing_is_compiled_ahead_where_kernels_are_not_kept(tmp_path, started):
    ahead.start(None)
    ahead.start(str(tmp_path / "gone"))
    assert not started


def test_what_is_compiled_ahead_is_what_is_called(tmp_path):
    (tmp_path / "torch.py").write_text("raise SystemExit('a file of the folder was run')")
    raw = expose(IMAGES, SHOT).requires_grad_()
    develop(raw, SHOT).sum().backward()  # compiled now, if never before
    count = """
from moireaug.engine import batch
print([len(k.stats.cache_misses) for k in (batch.develop, batch.develop_back)])
"""
    given = [a + count if a == ahead.CODE else a for a in ahead.ARGUMENTS]
    command = [sys.executable, *given]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.stdout == "[0, 0]\n", done.stderr


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_reading_that_is_not_finite_is_left_to_the_reference(value):
    raw = expose(IMAGES, SHOT)
    raw[1, 2, 3, 4] = value
    with reference():
        expected = develop(raw, SHOT)
    assert torch.equal(develop(raw, SHOT).nan_to_num(-1), expected.nan_to_num(-1))


def test_the_reference_is_forced_until_the_last_block_is_left():
    first, second = reference(), reference()  # as two threads open and leave them
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert explain(SHOT.scene).count("reference:") == 2
    second.__exit__(None, None, None)
    assert "reference:" not in explain(SHOT.scene)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("denoise", None, "float32"),
        ("denoise", "bilateral", "float32; reference from 'denoise' on"),
        ("jpeg", 90.0, "float32; reference from 'jpeg' on"),
    ],
)
def test_what_the_engine_leaves_to_the_reference_is_said(field, value, said):
    how = dataclasses.replace(SHOT.scene.develop, **{field: value})
    exposes, develops = explain(dataclasses.replace(SHOT.scene, develop=how)).splitlines()
    assert exposes.endswith("engine, on the CPU in float32")
    assert develops.endswith(said)


def test_a_reading_of_nan_has_no_jpeg():
    how = dataclasses.replace(SHOT.scene.develop, jpeg=90.0)
    shot = dataclasses.replace(SHOT, scene=dataclasses.replace(SHOT.scene, develop=how))
    raw = expose(IMAGES, shot)
    raw[1, 2, 3, 4] = float("nan")
    with pytest.raises(ValueError, match="NaN, which has no 8-bit code"):
        develop(raw, shot)


HALF = """
from moireaug.engine.compiling import kernel

@kernel
def half(x):
    return x / 2

print("ready", flush=True)
input()
assert half(3.0) == 1.5
print(len(half.stats.cache_hits), len(half.stats.cache_misses))
"""


def test_processes_that_start_together_compile_a_kernel_once(tmp_path):
    script = tmp_path / "half.py"
    script.write_text(HALF)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    command = [sys.executable, str(script)]
    started = []
    for _ in range(2):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        started.append(subprocess.Popen(command, env=environment, **pipes))
    for process in started:
        assert process.stdout.readline() == b"ready\n"
    for process in started:
        process.stdin.write(b"\n")
        process.stdin.flush()
    said = [process.communicate(timeout=120)[0].split() for process in started]
    assert sorted(said) == [[b"0", b"1"], [b"1", b"0"]]


FORKED = """
import multiprocessing as mp
import torch
from moireaug import Scene, capture
scene = Scene.preset("screen_photo")
def work(seed):
    shot = scene.sample(4, (40, 40), torch.Generator().manual_seed(seed))
    return capture(torch.full((4, 3, 40, 40), 0.5), shot)
if __name__ == "__main__":
    torch.set_num_threads(2)
    torch.rand(64, 3, 64, 64).sqrt()  # PyTorch's threads start
    with mp.get_context("fork").Pool(1) as pool:
        found = pool.map_async(work, [0]).get(200)
    assert torch.equal(found[0], work(0))
"""


def test_a_forked_process_takes_the_first_photo(tmp_path):
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    subprocess.run([sys.executable, script], check=True, timeout=300, env=environment)


def test_the_defaults_of_torch_change_nothing():
    scene = Scene(view=View(yaw=(0, 89), pitch=(0, 89), fov=60))  # the reference takes some rows
    shot, images = (
        scene.sample(16, (32, 32), torch.Generator().manual_seed(0)),
        torch.rand(16, 3, 32, 32),
    )
    expected = capture(images, shot)
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(capture(images, shot), expected)
    finally:
        torch.set_default_dtype(torch.float32)
    with torch.device("meta"):  # as where it is a GPU
        again = SHOT.scene.sample(4, (16, 20), torch.Generator("cpu").manual_seed(0))
        assert torch.equal(capture(IMAGES, again), photos())


@pytest.mark.filterwarnings("ignore:.torch.jit.script:FutureWarning")  # PyTorch's own call
def test_a_tangent_is_not_lost():
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(IMAGES, torch.ones_like(IMAGES))
        with pytest.raises(NotImplementedError, match="forward AD"):  # of the reference's sampling
            capture(dual, SHOT)
