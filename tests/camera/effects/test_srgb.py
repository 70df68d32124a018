"""The transfer function of sRGB."""

import pytest
import torch

from moireaug.camera.effects.srgb import Decode, Encode


def decode(codes):
    return Decode()(codes, None)


def encode(light):
    return Encode()(light, None)


# IEC 61966-2-1: codes and the light that they stand for
SRGB = [(0.0, 0.0), (0.04, 0.04 / 12.92), (0.5, 0.21404114), (0.735357, 0.5), (1.0, 1.0)]


@pytest.mark.parametrize(("code", "light"), SRGB)
def test_codes_are_srgbs(code, light):
    given = torch.tensor([code, light], dtype=torch.float64)[:, None, None, None].expand(2, 3, 1, 1)
    assert decode(given)[0].flatten().tolist() == pytest.approx([light] * 3, abs=1e-6)
    assert encode(given)[1].flatten().tolist() == pytest.approx([code] * 3, abs=1e-5)


def test_codes_and_light_are_inverses_with_finite_slopes():
    codes = torch.linspace(0, 1, 256, dtype=torch.float64).expand(1, 3, 1, -1)
    assert (encode(decode(codes)) - codes).abs().max() < 1e-5
    light = torch.linspace(-0.2, 1.2, 281, dtype=torch.float64).expand(1, 3, 1, -1)
    for f, x in ((decode, codes), (encode, light)):
        given = x.clone().requires_grad_()
        (slope,) = torch.autograd.grad(f(given).sum(), given)
        assert slope.isfinite().all() and (slope > 0).all()
    # noise may leave light below zero
    assert torch.allclose(encode(light)[light < 0], 12.92 * light[light < 0])
