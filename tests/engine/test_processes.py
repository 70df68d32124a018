"""The engine in workers, forked processes and processes that start together."""

import multiprocessing
import os
import subprocess
import sys

import torch
from torch.utils.data import DataLoader, Dataset

from moireaug import Scene, capture, develop, expose
from moireaug.capture import reading_of
from moireaug.engine.cpu import compiling, first_use

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


def test_forked_workers_see_the_same_photos():
    torch.set_num_threads(2)
    expected = photos()  # threads have run in this process before it forks
    loader = DataLoader(Photos(), batch_size=2, num_workers=1, multiprocessing_context="fork")
    assert torch.equal(torch.cat(list(loader)), expected)


def half(x):
    return x / 2


def test_processes_that_start_together_compile_a_kernel_once(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "folder", lambda: str(tmp_path))
    compiled, fork = compiling.kernel(half), multiprocessing.get_context("fork")
    both, said = fork.Barrier(2), fork.SimpleQueue()

    def work():
        both.wait()
        assert compiled(3.0) == 1.5
        said.put([len(compiled.stats.cache_hits), len(compiled.stats.cache_misses)])

    started = [fork.Process(target=work) for _ in range(2)]
    for process in started:
        process.start()
    for process in started:
        process.join(120)
        assert process.exitcode == 0
    assert sorted(said.get() for _ in started) == [[0, 1], [1, 0]]


FORKED = """
import multiprocessing as mp
import torch
from moireaug import Scene, capture
scene = Scene.preset("screen_photo")
def work(seed):
    shot = scene.sample(4, (40, 40), torch.Generator().manual_seed(seed))
    return capture(torch.full((4, 3, 40, 40), 0.5), shot)
torch.set_num_threads(2)
torch.rand(64, 3, 64, 64).sqrt()  # PyTorch's threads start
with mp.get_context("fork").Pool(1) as pool:
    found = pool.map_async(work, [0]).get(200)
assert torch.equal(found[0], work(0))
torch.save(found[0], "photo.pt")
"""
COUNT = """
from moireaug.engine.cpu import develop_kernels as develop, expose_kernels as expose
kernels = expose.show_kernel, develop.develop_kernel, develop.develop_back_kernel
print([len(kernel.stats.cache_misses) for kernel in kernels])
"""


def test_a_new_process_forks_and_then_compiles_ahead_what_is_called(tmp_path):
    """Its child takes the first photo, which is that of this process."""
    shot = SHOT.scene.sample(4, (40, 40), torch.Generator().manual_seed(0))
    raw = expose(IMAGES, SHOT).requires_grad_()
    reading_of((255 * IMAGES).byte(), SHOT)
    develop(raw, SHOT).sum().backward()  # compiled now, if never before
    (tmp_path / "torch.py").write_text("raise SystemExit('a file of the folder was run')")
    code = FORKED + first_use.HELPER_CODE + COUNT
    given = [code if a == first_use.HELPER_CODE else a for a in first_use.PYTHON_ARGUMENTS]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    output = {"capture_output": True, "text": True, "cwd": tmp_path, "env": environment}
    done = subprocess.run([sys.executable, *given], timeout=300, **output)
    assert done.stdout == "[0, 0, 0]\n", done.stderr
    expected = capture(torch.full((4, 3, 40, 40), 0.5), shot)
    assert torch.equal(torch.load(tmp_path / "photo.pt"), expected)
