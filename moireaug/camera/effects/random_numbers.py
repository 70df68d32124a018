"""Random numbers for sensor noise: a function of (seed, pixel), bit for bit the same on every
device.

A hash of the pixel's index, keyed by the image's seed, gives 32 bits. Their upper 11 choose one of
2048 intervals of equal probability of the normal distribution, the lower 21 a place in it. It takes
only tables and integers, so that PyTorch on any device and the engine's kernels agree.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from statistics import NormalDist

import torch
from torch import Tensor

from moireaug.common.tensor_physics import random_numbers

INTERVALS = 2048
PLACES_PER_INTERVAL = 2**21
WEYL_STEP = 0x9E3779B9 - 2**32  # as an int32


@functools.lru_cache(maxsize=1)
def quantiles() -> tuple[Tensor, Tensor]:
    """Return each interval's lower end and the step from one place in it to the next: (2048,)
    float32 each.

    The outermost intervals end where the variance of the numbers is exactly 1.
    """
    ends = [NormalDist().inv_cdf(j / INTERVALS) for j in range(1, INTERVALS)]
    # a uniform number between a and b has the second moment (a^2 + a b + b^2) / 3
    inner = sum(a * a + a * b + b * b for a, b in itertools.pairwise(ends)) / 3
    last = ends[-1]
    outer = (INTERVALS - inner) * 3 / 2
    end = (math.sqrt(4 * outer - 3 * last * last) - last) / 2
    edges = torch.tensor([-end, *ends, end], dtype=torch.float64, device="cpu")
    return edges[:-1].float(), (edges.diff() / PLACES_PER_INTERVAL).float()


def keys(seeds: Tensor) -> tuple[Tensor, Tensor]:
    """Return the two 32-bit keys of each seed (B,) int64: (B,) int32 each."""
    first = random_numbers.mix(seeds.to(torch.int32))
    return first, random_numbers.mix((seeds >> 32).to(torch.int32) ^ first ^ WEYL_STEP)


def normal(shape: Sequence[int], seeds: Tensor) -> Tensor:
    """Return standard normal numbers (len(seeds), *shape), float32, on the device of `seeds`.

    Args:
        shape: shape of one image's numbers. Number i of an image, in row-major order, depends only
            on its seed and i.
        seeds: (B,) int64.

    Not differentiable.
    """
    first, second = keys(seeds)
    index = torch.arange(math.prod(shape), dtype=torch.int32, device=seeds.device)
    keyed = random_numbers.mix(index + first[:, None]) ^ second[:, None]
    bits = random_numbers.mix(keyed).flatten()
    low, step = (table.to(seeds.device) for table in quantiles())
    interval = (bits >> 21).bitwise_and_(INTERVALS - 1)
    place = bits.bitwise_and_(PLACES_PER_INTERVAL - 1).float()
    # two roundings: the sum and the product must not be fused
    numbers = step.index_select(0, interval).mul_(place).add_(low.index_select(0, interval))
    return numbers.reshape(len(seeds), *shape)


# a custom operator, since torch.compile cannot trace its tables; defined by hand, because
# `custom_op` imports the compiler on its first call, a second or more in every worker
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
LIBRARY.define("normal(SymInt[] shape, Tensor seeds) -> Tensor")
LIBRARY.impl("normal", normal, "CompositeExplicitAutograd")
torch.library.register_fake(
    "moireaug::normal",
    lambda shape, seeds: seeds.new_empty((len(seeds), *shape), dtype=torch.float32),
    lib=LIBRARY,
)
