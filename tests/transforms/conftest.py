"""What the tests of the transforms share: a picture whose parts can be found again in its photo."""

import pytest
import torch


@pytest.fixture
def marked():
    """(3, 48, 64): black but for one white rectangle, `SQUARE`."""
    image = torch.zeros(3, 48, 64)
    image[:, 10:18, 30:40] = 1
    return image


@pytest.fixture
def find():
    """Where the light is in a photo (C, H, W): its centroid (x, y), and the box of the brighter
    half."""

    def look(photo):
        light = photo.float().mean(0)
        y, x = (torch.arange(n) + 0.5 for n in light.shape)
        centroid = torch.stack([(light.sum(0) * x).sum(), (light.sum(1) * y).sum()]) / light.sum()
        on = light > light.max() / 2
        xs, ys = x[on.any(0)], y[on.any(1)]
        return centroid, torch.stack(
            [xs.min() - 0.5, ys.min() - 0.5, xs.max() + 0.5, ys.max() + 0.5]
        )

    return look
