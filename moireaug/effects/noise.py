"""Sensor noise. Every draw comes from a seed kept in the Shot, so that a Shot replays bit for bit."""

from __future__ import annotations

import torch
from torch import Tensor


def read_noise(raw: Tensor, std: Tensor, seeds: Tensor) -> Tensor:
    """Add Gaussian noise of standard deviation `std` (B,) to `raw` (B, 4, h, w), one stream per seed (B,) int64.

    Differentiable in raw and std. Replays exactly on devices of one type.
    """
    noise = torch.empty_like(raw)
    generator = torch.Generator(raw.device)
    for row, seed in zip(noise, seeds.tolist(), strict=True):
        row.normal_(generator=generator.manual_seed(seed))
    return raw + noise * std.to(raw.dtype)[:, None, None, None]
