"""The generator of sensor noise: as defined, normal, and without memory."""

import numpy as np
import pytest
import torch
from scipy import stats

from moireaug.camera.effects.random_numbers import normal, quantiles

MASK = 0xFFFFFFFF


def mix(x):
    x ^= x >> 16
    x = x * 0x7FEB352D & MASK
    x ^= x >> 15
    x = x * 0x846CA68B & MASK
    return x ^ x >> 16


def plain(n, seed):
    """Follow the definition in Python's whole numbers and numpy's float32."""
    low, step = (table.numpy() for table in quantiles())
    first = mix(seed & MASK)
    second = mix((seed >> 32 & MASK) ^ first ^ 0x9E3779B9)
    out = np.empty(n, np.float32)
    for i in range(n):
        h = mix(mix((i + first) & MASK) ^ second)
        out[i] = low[h >> 21] + step[h >> 21] * np.float32(h & 0x1FFFFF)
    return out


SEEDS = (0, 1, 2, 2**31, 2**32, 2**53 - 1, 2**63 - 1, -1, -(2**63))


@pytest.mark.parametrize("seed", SEEDS)
def test_follows_its_definition_bit_for_bit(seed):
    got = normal((3, 11, 13), torch.tensor([seed]))
    assert got.shape == (1, 3, 11, 13)
    assert got.dtype == torch.float32
    assert np.array_equal(got.numpy().ravel(), plain(3 * 11 * 13, seed))


def test_a_row_depends_on_its_seed_alone():
    seeds = torch.tensor(SEEDS)
    batch = normal((4, 5, 7), seeds)
    for i in range(len(seeds)):
        assert torch.equal(batch[i : i + 1], normal((4, 5, 7), seeds[i : i + 1]))
    assert len({row.numpy().tobytes() for row in batch}) == len(seeds)
    assert seeds.tolist() == list(SEEDS)


@pytest.mark.parametrize(("n", "shape"), [(0, (4, 2, 2)), (1, (4, 0, 3)), (2, (1, 1, 1))])
def test_empty_and_single_shapes(n, shape):
    assert normal(shape, torch.zeros(n, dtype=torch.int64)).shape == (n, *shape)


def test_the_table_is_even_and_has_variance_one():
    low, step = (table.double() for table in quantiles())
    high = low + step * 2**21
    assert torch.allclose(high[:-1], low[1:], rtol=0, atol=3e-7)
    assert torch.allclose(low, -high.flip(0), rtol=0, atol=6e-7)
    assert float((low**2 + low * high + high**2).mean() / 3) == pytest.approx(1, abs=1e-7)


N = 2**20


@pytest.fixture(scope="module")
def sample():
    return normal((4, 512, 512), torch.tensor([20240, 20241])).double()


def test_moments(sample):
    for z in sample.flatten(1):
        assert abs(z.mean()) < 4 / N**0.5
        assert abs(z.var() - 1) < 4 * (2 / N) ** 0.5
        assert abs((z**3).mean()) < 4 * (15 / N) ** 0.5
        # the ends are cut at 3.8, which takes less than a fortieth of the fourth moment
        assert abs((z**4).mean() - 3) < 0.075


def test_kolmogorov_smirnov(sample):
    for z in sample.flatten(1)[:, : N // 4]:
        assert stats.kstest(z.numpy(), "norm").pvalue > 1e-3
        # negative control: a wrong width
        assert stats.kstest(1.02 * z.numpy(), "norm").pvalue < 1e-3


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("lag", [1, 2, 3, 16, 511, 512, 513, 512 * 512])
def test_pixels_do_not_know_of_their_neighbours(sample, lag, power):
    for z in sample.flatten(1) ** power:
        assert abs(correlation(z[lag:], z[:-lag])) < 4.5 / (N - lag) ** 0.5


@pytest.mark.parametrize("power", [1, 2])
def test_seeds_do_not_know_of_one_another(power):
    seeds = torch.tensor([0, 1, 2, 3, 4, 8, 2**31, 2**32, 2**33, 2**53 - 1])
    z = normal((4, 128, 128), seeds).double().flatten(1) ** power
    found = torch.corrcoef(z) - torch.eye(len(seeds))
    assert found.abs().max() < 4.5 / z.shape[1] ** 0.5


def test_the_first_pixel_is_normal_over_seeds():
    first = normal((1, 1, 2), torch.arange(2**18)).double().flatten(1)
    assert stats.kstest(first[:, 0].numpy(), "norm").pvalue > 1e-3
    assert abs(correlation(first[:, 0], first[:, 1])) < 4.5 / 2**9
    assert abs(correlation(first[1:, 0], first[:-1, 0])) < 4.5 / 2**9
    # the second pixel of one seed must not be the first of the next
    assert abs(correlation(first[:-1, 1], first[1:, 0])) < 4.5 / 2**9


def correlation(a, b):
    return float(torch.corrcoef(torch.stack([a, b]))[0, 1])
