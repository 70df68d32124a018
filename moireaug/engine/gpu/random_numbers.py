"""The numbers of `moireaug.camera.effects.random_numbers`, bit for bit."""

from __future__ import annotations

import functools

import torch
import triton
import triton.language as tl
from torch import Tensor

from moireaug.camera.effects import random_numbers as numbers
from moireaug.engine.gpu.physics import random_numbers

INTERVAL_SHIFT = tl.constexpr(numbers.PLACES_PER_INTERVAL.bit_length() - 1)
INTERVAL_MASK = tl.constexpr(numbers.INTERVALS - 1)
PLACE_MASK = tl.constexpr(numbers.PLACES_PER_INTERVAL - 1)


@functools.lru_cache(maxsize=8)
def quantiles(device: torch.device) -> Tensor:
    """Return `random_numbers.quantiles` on a device, (2048, 2) float32: low, and step."""
    return torch.stack(numbers.quantiles(), 1).contiguous().to(device)


@triton.jit
def normal(index, keys, quantiles):
    """Return the standard normal numbers of these indices of an image, float32.

    Args:
        index: int32. keys: (2,) int32, of the image. quantiles: (2048, 2) float32, see there.
    """
    first = tl.load(keys).to(tl.uint32, bitcast=True)
    second = tl.load(keys + 1).to(tl.uint32, bitcast=True)
    bits = random_numbers.mix(random_numbers.mix(index.to(tl.uint32) + first) ^ second)
    interval = (bits >> INTERVAL_SHIFT) & INTERVAL_MASK
    place = (bits & PLACE_MASK).to(tl.float32)
    low, step = tl.load(quantiles + 2 * interval), tl.load(quantiles + 2 * interval + 1)
    # a product that is rounded by itself: the compiler would fuse another with the sum
    return low + tl.fma(step, place, 0.0)
