"""What a sensor makes of light: noise from a seed alone, of the right size, and whole numbers."""

import pytest
import torch

from moireaug.camera.effects.random_numbers import normal
from moireaug.camera.effects.sensor import DARK_LEVEL, add_noise, quantise

SEEDS = torch.tensor([3, 11, 3, 2**53 - 1])


def fields(*numbers):
    return torch.tensor(numbers, dtype=torch.float64)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_each_row_comes_from_its_seed_alone(dtype):
    raw = torch.full((4, 4, 5, 6), 0.5, dtype=dtype)
    read, shot = fields(0.1, 0.1, 0.1, 0.1), fields(0, 0, 0, 0)
    noisy = add_noise(raw, read, shot, SEEDS)
    assert noisy.dtype == dtype and noisy.shape == raw.shape
    assert torch.equal(noisy, add_noise(raw, read, shot, SEEDS))
    assert torch.equal(noisy[0], noisy[2])
    assert torch.equal(noisy[[3, 1]], add_noise(raw[:2], read[:2], shot[:2], SEEDS[[3, 1]]))
    assert not torch.equal(noisy[0], noisy[1]) and not torch.equal(noisy[1], noisy[3])


def test_noise_does_not_touch_the_global_generator():
    torch.manual_seed(4)
    wanted = torch.rand(3)
    torch.manual_seed(4)
    add_noise(torch.zeros(4, 1, 2, 2), fields(1, 1, 1, 1), fields(0, 0, 0, 0), SEEDS)
    assert torch.equal(torch.rand(3), wanted)


def test_photon_noise_ends_at_the_dark_current():
    """Below it, and below zero, its slope and size stay finite."""
    raw = fields(-1.0, 0.0, DARK_LEVEL, 1.0).reshape(1, 1, 1, 4).requires_grad_()
    noisy = add_noise(raw, fields(0.0), fields(0.1), SEEDS[:1])
    size = (noisy - raw) / normal(raw.shape[1:], SEEDS[:1])
    assert size.flatten().tolist() == pytest.approx([0.1 * DARK_LEVEL**0.5] * 3 + [0.1])
    (gradient,) = torch.autograd.grad(noisy.sum(), raw)
    assert gradient.isfinite().all() and gradient.flatten()[:2].tolist() == [1, 1]


def test_gradients_of_every_argument():
    raw = (torch.rand(2, 1, 2, 3, dtype=torch.float64) + 0.1).requires_grad_()
    read, shot = fields(0.02, 0.1).requires_grad_(), fields(0.05, 0.01).requires_grad_()
    assert torch.autograd.gradcheck(lambda *a: add_noise(*a, SEEDS[:2]), (raw, read, shot))


@pytest.mark.parametrize("bits", [1, 2, 8, 16])
def test_a_converter_ends_at_its_levels(bits):
    raw = fields(-0.3, 0.0, 0.5 / (2**bits - 1) * 0.99, 1 - 1e-9, 1.0, 1.4)
    assert quantise(raw, bits).tolist() == pytest.approx([0, 0, 0, 1, 1, 1], abs=1e-12)


def test_normal_is_a_sound_operator():
    found = torch.library.opcheck(torch.ops.moireaug.normal.default, ((2, 3, 3), SEEDS))
    assert found and set(found.values()) == {"SUCCESS"}
