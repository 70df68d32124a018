"""Sensor noise and digits. Every draw comes from a seed kept in the Shot, so that a Shot replays bit for bit."""

from __future__ import annotations

import torch
from torch import Tensor

DARK = 1e-4  # the level, of full scale, below which photon noise falls no further: dark current


def sensor_noise(raw: Tensor, read: Tensor, shot: Tensor, seeds: Tensor) -> Tensor:
    """Add Gaussian noise of variance `read^2 + shot^2 * raw` to `raw` (B, C, h, w), one stream per seed (B,) int64.

    Photon noise is Poisson's in its Gaussian limit, in the reading's own light; a full well of N electrons has
    `shot = N^-1/2`. Differentiable in raw, read and shot. Replays exactly on devices of one type.
    """
    noise = torch.ops.moireaug.normal(raw.detach(), seeds)
    read, shot = (t.to(raw.dtype)[:, None, None, None] for t in (read, shot))
    variance = read.square() + shot.square() * raw.clamp(min=DARK)
    some = variance > 0  # the root has no slope at 0
    return raw + noise * torch.where(some, torch.where(some, variance, 1.0).sqrt(), 0.0)


def read_noise(raw: Tensor, read: Tensor, seeds: Tensor) -> Tensor:
    """`sensor_noise` in the dark."""
    return torch.addcmul(raw, torch.ops.moireaug.normal(raw.detach(), seeds), read.to(raw.dtype)[:, None, None, None])


def normal(like: Tensor, seeds: Tensor) -> Tensor:
    """Standard normal numbers of the shape of `like`, row i from seed i alone."""
    noise = torch.empty_like(like, memory_format=torch.contiguous_format)
    generator = torch.Generator(like.device)
    for row, seed in zip(noise, seeds.tolist(), strict=True):
        row.normal_(generator=generator.manual_seed(seed))
    return noise


def _shape(like: Tensor, seeds: Tensor) -> Tensor:
    return torch.empty_like(like, memory_format=torch.contiguous_format)


# an operator of its own, since torch.compile cannot look into generators; defined by hand, because `custom_op` imports
# the compiler on its first call, a second and more in every worker
LIBRARY = torch.library.Library("moireaug", "FRAGMENT")
LIBRARY.define("normal(Tensor like, Tensor seeds) -> Tensor")
LIBRARY.impl("normal", normal, "CompositeExplicitAutograd")
torch.library.register_fake("moireaug::normal", _shape, lib=LIBRARY)


def quantise(raw: Tensor, bits: int) -> Tensor:
    """Round to the `2^bits` levels of a converter whose ends are 0 and 1; the gradient passes straight through."""
    levels = 2**bits - 1
    return raw + (torch.round(raw.detach().clamp(0, 1) * levels) / levels - raw.detach())
