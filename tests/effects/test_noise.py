"""Sensor noise: from a seed alone, of the right size, and rounded to what a converter gives."""

import pytest
import torch

from moireaug.effects.noise import DARK, normal, quantise, read_noise, sensor_noise

SEEDS = torch.tensor([3, 11, 3, 2**53 - 1])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_each_row_comes_from_its_seed_alone(dtype):
    like = torch.zeros(4, 4, 5, 6, dtype=dtype)
    noise = normal(like, SEEDS)
    assert noise.dtype == dtype and noise.shape == like.shape
    assert torch.equal(noise, normal(like, SEEDS))
    assert torch.equal(noise[0], noise[2])
    assert torch.equal(noise[[3, 1]], normal(like[:2], SEEDS[[3, 1]]))
    assert not torch.equal(noise[0], noise[1]) and not torch.equal(noise[1], noise[3])


def test_noise_does_not_touch_the_global_generator():
    torch.manual_seed(4)
    wanted = torch.rand(3)
    torch.manual_seed(4)
    normal(torch.zeros(4, 1, 2, 2), SEEDS)
    assert torch.equal(torch.rand(3), wanted)


def test_noise_is_normal_and_white():
    noise = normal(torch.zeros(2, 1, 300, 300, dtype=torch.float64), SEEDS[:2])[:, 0]
    deviations = 4 / 300  # of a mean of 300 x 300 numbers, in standard deviations of its own
    assert noise.mean((1, 2)).abs().max() < deviations
    assert (noise.square().mean((1, 2)) - 1).abs().max() < 1.5 * deviations
    assert (noise.pow(4).mean((1, 2)) - 3).abs().max() < 10 * deviations
    for neighbour in (noise[:, 1:] * noise[:, :-1], noise[..., 1:] * noise[..., :-1], noise[0] * noise[1]):
        assert neighbour.mean().abs() < deviations


def test_read_noise_is_sensor_noise_without_light():
    raw, read = torch.rand(4, 4, 5, 6, dtype=torch.float64), torch.tensor([0.0, 0.01, 0.1, 1.0], dtype=torch.float64)
    quiet = sensor_noise(raw, read, torch.zeros(4).double(), SEEDS)
    assert torch.allclose(read_noise(raw, read, SEEDS), quiet, atol=1e-15)
    assert torch.equal(quiet[0], raw[0])


def test_photon_noise_ends_at_the_dark_current():
    """Below it, and below zero, its slope and size stay finite."""
    raw = torch.tensor([-1.0, 0.0, DARK, 1.0], dtype=torch.float64).reshape(1, 1, 1, 4).requires_grad_()
    read, shot = torch.zeros(1, dtype=torch.float64), torch.full((1,), 0.1, dtype=torch.float64)
    noisy = sensor_noise(raw, read, shot, SEEDS[:1])
    size = (noisy - raw) / normal(raw.detach(), SEEDS[:1])
    assert size.flatten().tolist() == pytest.approx([0.1 * DARK**0.5] * 3 + [0.1])
    (gradient,) = torch.autograd.grad(noisy.sum(), raw)
    assert gradient.isfinite().all() and gradient.flatten()[:2].tolist() == [1, 1]


def test_gradients_of_every_argument():
    raw = (torch.rand(2, 1, 2, 3, dtype=torch.float64) + 0.1).requires_grad_()
    read, shot = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in ([0.02, 0.1], [0.05, 0.01]))
    assert torch.autograd.gradcheck(lambda *a: sensor_noise(*a, SEEDS[:2]), (raw, read, shot))
    assert torch.autograd.gradcheck(lambda *a: read_noise(*a, SEEDS[:2]), (raw, read))


@pytest.mark.parametrize("bits", [1, 2, 8, 16])
def test_a_converter_ends_at_its_levels(bits):
    raw = torch.tensor([-0.3, 0.0, 0.5 / (2**bits - 1) * 0.99, 1 - 1e-9, 1.0, 1.4], dtype=torch.float64)
    assert quantise(raw, bits).tolist() == pytest.approx([0, 0, 0, 1, 1, 1], abs=1e-12)


def test_normal_is_a_sound_operator():
    found = torch.library.opcheck(torch.ops.moireaug.normal.default, (torch.zeros(4, 2, 3, 3), SEEDS))
    assert found and set(found.values()) == {"SUCCESS"}


def test_noise_compiles_in_one_graph():
    args = torch.rand(4, 4, 5, 6), torch.full((4,), 0.01), torch.full((4,), 0.02), SEEDS
    compiled = torch.compile(sensor_noise, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(*args), sensor_noise(*args))
