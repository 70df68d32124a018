"""What every test shares: small images, threads that do not fight over the cores, and quiet third
parties."""

import gc
import os

os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import pytest
import torch

for kind in (torch.cuda, torch.mtia, torch.xpu):
    if not kind.is_available():
        # each seed for what is not there is kept with its stack, which takes milliseconds
        kind.manual_seed_all = lambda seed: None

# pytest-xdist gives each core a process of its own: two threads in each would wait for one another.
THREADS = 1 if "PYTEST_XDIST_WORKER" in os.environ else 2


# The first worker begins with what needs no kernels, while another compiles them, and goes on with
# what takes longest: the end of the suite, where workers take tests from one another, is of small
# ones.
FIRST = ("tests/engine/gpu/", "tests/defenses/", "tests/camera/effects/", "tests/training/")


def pytest_collection_modifyitems(items):
    def place(item):
        begins = [item.nodeid.startswith(folder) for folder in FIRST]
        return begins.index(True) if any(begins) else len(FIRST)

    items.sort(key=place)


def pytest_collection_finish():
    # what is imported stays: collections that pass over it save a twentieth of the suite's time
    gc.collect()
    gc.freeze()


def pytest_sessionfinish():
    gc.unfreeze()  # nanobind would list what is never collected


@pytest.fixture(autouse=True)
def _threads_and_seed():
    torch.set_num_threads(THREADS)
    torch.manual_seed(0)


@pytest.fixture
def images():
    return torch.rand(4, 3, 24, 32, generator=torch.Generator().manual_seed(1))
