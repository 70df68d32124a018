"""Images that every defence meets, and few photos, for which no kernel is compiled."""

import pytest
import torch
import torch.nn.functional as F

from moireaug.engine.backends import reference


def natural(b=2, h=32, w=40, seed=0, dtype=torch.float32):
    """Smooth blobs of colour with an edge and a little noise, on 8-bit codes."""
    g = torch.Generator().manual_seed(seed)
    size = (b, 3, max(h // 8, 1), max(w // 8, 1))
    x = F.interpolate(torch.rand(size, generator=g), size=(h, w), mode="bicubic")
    x[:, :, h // 3 : h // 2, w // 4 : w // 2] = torch.rand(b, 3, 1, 1, generator=g)
    x = x + 0.02 * torch.randn(x.shape, generator=g)
    return ((x.clamp(0, 1) * 255).round() / 255).to(dtype)


@pytest.fixture
def photos():
    return natural


@pytest.fixture(autouse=True)
def _without_kernels():
    with reference():
        yield
