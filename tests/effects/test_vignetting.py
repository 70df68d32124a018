"""Vignetting: the darker corners."""

import math

import pytest
import torch

from moireaug.effects.vignetting import falloff


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.99])
@pytest.mark.parametrize("size", [(6, 8), (1, 1), (1, 9)])
def test_falloff_takes_its_share_in_the_very_corners(size, loss):
    h, w = size
    v, u = torch.tensor([0, h / 2, h]).double()[:, None], torch.tensor([0, w / 2, w]).double()
    dark = falloff(u, v, size, torch.tensor([loss], dtype=torch.float64))[0]
    assert dark[::2, ::2].flatten().tolist() == pytest.approx([1 - loss] * 4)
    assert dark[1, 1] == 1
    # along the ray of the corner the angle's tangent grows with the distance: half way out
    places = u / 2 + w / 4, v / 2 + h / 4
    half = falloff(*places, size, torch.tensor([loss], dtype=torch.float64))[0, 0, 0]
    corner = math.acos((1 - loss) ** 0.25)
    assert half.item() == pytest.approx(math.cos(math.atan(math.tan(corner) / 2)) ** 4)
