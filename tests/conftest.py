"""What every test shares: small images, threads that do not fight over the cores, and quiet third
parties."""

import gc
import os

os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import pytest
import torch

# pytest-xdist gives each core a process of its own: two threads in each would wait for one another.
THREADS = 1 if "PYTEST_XDIST_WORKER" in os.environ else 2


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
