"""The sensor's lattice: packed and unpacked, and what is read of it."""

import pytest
import torch

from moireaug.scene.geometry.lattice import pack, sampled_pixels, unpack


def test_planes_are_red_green_green_blue():
    mosaic = torch.arange(24.0).reshape(1, 4, 6)
    raw = pack(mosaic)
    assert raw[0, :, 0, 0].tolist() == [0, 1, 6, 7] and raw[0, :, 1, 2].tolist() == [16, 17, 22, 23]
    assert torch.equal(unpack(raw), mosaic)
    assert torch.equal(pack(unpack(raw)), raw)


FIVES = [2, 3, 4, 5, 6, 11, 12, 13, 14, 15]
SAMPLED = [  # size, scale, resize, reach, sensor pixels read, per photo pixel, ahead, kept
    (3, 1.0, "area", 1, [0, 1, 2, 3], 1, 0, [0, 1, 2]),
    (2, 3.0, "area", 1, [0, 1, 2, 3, 4, 5], 3, 0, [0, 1, 2, 3, 4, 5]),
    (2, 9.0, "point", 1, [2, 3, 4, 5, 12, 13, 14, 15], 3, 1, [3, 4, 5, 12, 13, 14]),
    (2, 9.0, "point", 2, FIVES, 5, 0, FIVES),
    (2, 8.0, "point", 1, [2, 3, 4, 5, 10, 11, 12, 13], 4, 0, [2, 3, 4, 5, 10, 11, 12, 13]),
    (2, 8.0, "point", 0, [3, 4, 11, 12], 2, 0, [3, 4, 11, 12]),
    (2, 9.0, "point", 0, [4, 13], 1, 0, [4, 13]),
    (4, 1.5, "area", 1, [0, 1, 2, 3, 4, 5], 0, 0, [0, 1, 2, 3, 4, 5]),
    (3, 1.5, "area", 1, [0, 1, 2, 3], 0, 0, [0, 1, 2, 3]),
    (3, 1.0, "area", 0, [0, 1, 2], 1, 0, [0, 1, 2]),
    (3, 2.0, "antialias", 1, [0, 1, 2, 3, 4, 5], 0, 0, [0, 1, 2, 3, 4, 5]),
    (3, 1.0, "antialias", 0, [0, 1, 2], 1, 0, [0, 1, 2]),
]


def test_what_is_read_of_an_axis():
    for *given, index, step, lead, kept in SAMPLED:
        pixels = sampled_pixels(*given)
        assert (list(pixels.index), pixels.step, pixels.lead) == (index, step, lead), given
        assert list(pixels.index[pixels.of_photo]) == kept, given
        if given[-1]:  # each of the parity of its place
            assert [i % 2 for i in pixels.index] == [0, 1] * (len(index) // 2), given


@pytest.mark.parametrize("b", [0, 2])
def test_unpacking_has_a_gradient(b):
    raw = torch.rand(b, 4, 3, 2, requires_grad=True)
    weight = torch.rand(b, 6, 4)
    (gradient,) = torch.autograd.grad((unpack(raw) * weight).sum(), raw)
    assert torch.equal(gradient, pack(weight))
