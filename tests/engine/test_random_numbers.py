"""The kernel's noise is the reference's, bit for bit."""

import numpy as np
import pytest
import torch
from numba import njit

from moireaug.camera.effects.random_numbers import keys, normal
from moireaug.engine.cpu.compiling import FAST_MATH
from moireaug.engine.cpu.normal import normal_row


# the kernels' products and sums are fused, which these must not be
@njit(fastmath=FAST_MATH)
def fill(out, bits, start, first, second):
    normal_row(out, bits, start, first, second)


@pytest.mark.parametrize("seed", [0, 1, 2**32, 2**53 - 1, -1, -(2**63)])
def test_rows_equal_the_reference_bit_for_bit(seed):
    seeds = torch.tensor([seed])
    expected = normal((4, 37, 101), seeds).numpy()[0].reshape(-1, 101)
    first, second = (k.numpy().view(np.uint32)[0] for k in keys(seeds))
    got, bits = np.empty_like(expected), np.empty(101, np.int32)
    for r in range(len(got)):
        fill(got[r], bits, r * 101, first, second)
    assert np.array_equal(got, expected)
