"""Tone: the transfer function of sRGB, white balance, the full well and the darker corners."""

import math

import pytest
import torch

from moireaug.effects import tone

# IEC 61966-2-1: codes and the light that they stand for
SRGB = [(0.0, 0.0), (0.04, 0.04 / 12.92), (0.5, 0.21404114), (0.735357, 0.5), (1.0, 1.0)]


@pytest.mark.parametrize(("code", "light"), SRGB)
def test_codes_are_srgbs(code, light):
    given = torch.tensor([code, light], dtype=torch.float64)[:, None, None, None].expand(2, 3, 1, 1)
    assert tone.decode(given)[0].flatten().tolist() == pytest.approx([light] * 3, abs=1e-6)
    assert tone.encode(given)[1].flatten().tolist() == pytest.approx([code] * 3, abs=1e-5)


def test_codes_and_light_are_inverses_with_finite_slopes():
    codes = torch.linspace(0, 1, 256, dtype=torch.float64).expand(1, 3, 1, 256).clone().requires_grad_()
    assert (tone.encode(tone.decode(codes)) - codes).abs().max() < 1e-5
    light = torch.linspace(-0.2, 1.2, 281, dtype=torch.float64).expand(1, 3, 1, 281).clone().requires_grad_()
    for f, x in ((tone.decode, codes), (tone.encode, light)):
        (slope,) = torch.autograd.grad(f(x).sum(), x)
        assert slope.isfinite().all() and (slope > 0).all()
    assert torch.allclose(tone.encode(light)[light < 0], 12.92 * light[light < 0])  # noise may leave light below zero


def test_a_full_well_reads_one_and_passes_no_gradient():
    raw = torch.tensor([-0.5, 0.0, 0.5, 1.0, 1.5], requires_grad=True)
    full = tone.saturate(raw)
    assert full.tolist() == tone.saturate(raw.detach()).tolist() == [-0.5, 0, 0.5, 1, 1]
    assert torch.autograd.grad(full.sum(), raw)[0].tolist() == [1, 1, 1, 1, 0]


def test_balance_leaves_green_alone():
    photo = torch.rand(2, 3, 4, 5)
    red, blue = torch.tensor([1.5, 0.5], dtype=torch.float64), torch.tensor([1.0, 2.0], dtype=torch.float64)
    out = tone.balance(photo, red, blue)
    assert out.dtype == photo.dtype and torch.equal(out[:, 1], photo[:, 1])
    assert torch.allclose(out[0, 0], 1.5 * photo[0, 0]) and torch.allclose(out[1, 2], 2 * photo[1, 2])
    assert torch.equal(out[0, 2], photo[0, 2]) and torch.allclose(out[1, 0], 0.5 * photo[1, 0])


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.99])
@pytest.mark.parametrize("size", [(6, 8), (1, 1), (1, 9)])
def test_falloff_takes_its_share_in_the_very_corners(size, loss):
    h, w = size
    rows, cols = torch.tensor([0, h / 2, h]).double(), torch.tensor([0, w / 2, w]).double()
    dark = tone.falloff(rows, cols, size, torch.tensor([loss], dtype=torch.float64))[0]
    assert dark[::2, ::2].flatten().tolist() == pytest.approx([1 - loss] * 4)
    assert dark[1, 1] == 1
    # along the ray of the corner the angle's tangent grows with the distance: half way out
    half = tone.falloff(rows / 2 + h / 4, cols / 2 + w / 4, size, torch.tensor([loss], dtype=torch.float64))[0, 0, 0]
    corner = math.acos((1 - loss) ** 0.25)
    assert half.item() == pytest.approx(math.cos(math.atan(math.tan(corner) / 2)) ** 4)
