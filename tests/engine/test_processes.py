"""The engine in workers, forked processes and processes that start together."""

import os
import subprocess
import sys

import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from moireaug import Scene, capture

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


HALF = """
from moireaug.engine.cpu.compiling import kernel

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
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert done.returncode == 0, done.stderr
