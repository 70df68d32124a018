"""Colour differences, against published pairs."""

import pytest
import torch

from benchmarks.colour import ciede2000, visible_difference

# Sharma, Wu and Dalal (2005), table 1
PAIRS = [
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, 3.1571, -77.2803), (50, 0, -82.7485), 2.8615),
    ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0),
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
    ((50, 2.49, -0.001), (50, -2.49, 0.0011), 7.2195),
    ((50, -0.001, 2.49), (50, 0.0009, -2.49), 4.8045),
    ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((50, 2.5, 0), (50, 3.1736, 0.5854), 1.0),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


@pytest.mark.parametrize(("first", "second", "expected"), PAIRS)
def test_ciede2000_is_as_published(first, second, expected):
    a, b = (torch.tensor([lab], dtype=torch.float64) for lab in (first, second))
    assert ciede2000(a, b).item() == pytest.approx(expected, abs=5e-5)
    assert ciede2000(b, a).item() == pytest.approx(expected, abs=5e-5)
    assert ciede2000(a, a).item() == 0


def test_black_and_white_are_a_hundred_apart():
    black, white = torch.zeros(1, 3, 2, 2), torch.ones(1, 3, 2, 2)
    assert visible_difference(black, white).shape == (1, 2, 2)
    assert torch.allclose(visible_difference(black, white), torch.tensor(100.0), atol=0.01)
