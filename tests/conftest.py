"""What every test shares: two threads, small images, and quiet third parties."""

import os

os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import pytest
import torch


@pytest.fixture(autouse=True)
def _two_threads():
    torch.set_num_threads(2)
    torch.manual_seed(0)


@pytest.fixture
def images():
    return torch.rand(4, 3, 24, 32, generator=torch.Generator().manual_seed(1))
