"""Augmentations to compare, each of batches and after crops and flips: with moiré, without, and
others'."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torchvision.transforms import v2

from moireaug.mixtures import as_scenes, map_scenes
from moireaug.synthesis.twins import without_subpixels
from moireaug.transforms import RandomMoire

Augmentation = Callable[[Tensor], Tensor]  # images (B, 3, H, W) in [0, 1] to the same
SCENES = ["screen_photo", "phone_at_laptop"]
SHRINK = (1.0, 3.0)  # sensor pixels per image pixel of crops
AUGMIX_GROUP = 4  # images that share AugMix's operations, though not their mixture
MAX_WAVES, MAX_ROUNDS, BETA = 3, 4, 3.0  # of MoireMix; the last two are PixMix's own


def augmix(images: Tensor) -> Tensor:
    """Augment as AugMix does, without the operations that are corruptions of the test."""
    mix = v2.AugMix(all_ops=False)
    codes = (255 * images).round().byte()
    return torch.cat([mix(part) for part in codes.split(AUGMIX_GROUP)]) / 255


def moiremix(images: Tensor) -> Tensor:
    """Mix images with one to three circular sines or with themselves, by PixMix's additions and
    products, in up to four rounds: the augmentation of MoireMix (arXiv 2603.25109), without
    PixMix's other operations."""
    n, _, h, w = images.shape
    mixed, rounds = images, torch.randint(0, MAX_ROUNDS + 1, (n, 1, 1, 1))
    beta = torch.distributions.Beta(BETA, 1.0)
    for k in range(MAX_ROUNDS):
        partner = torch.where(torch.rand(n, 1, 1, 1) < 0.5, images, circular_sines(n, h, w))
        ours, theirs = beta.sample((n, 1, 1, 1)), 1 - beta.sample((n, 1, 1, 1))
        outside = torch.rand(n, 1, 1, 1) < 0.5  # weights beyond [0, 1], which sum to about one, too
        ours, theirs = torch.where(outside, 2 - ours, ours), torch.where(outside, -theirs, theirs)
        added = (ours * (2 * mixed - 1) + theirs * (2 * partner - 1) + 1) / 2
        product = (2 * mixed) ** ours * (2 * partner).clamp(min=1e-3) ** theirs / 2
        result = torch.where(torch.rand(n, 1, 1, 1) < 0.5, added, product).clamp(0, 1)
        mixed = torch.where(k < rounds, result, mixed)
    return mixed


def circular_sines(n: int, h: int, w: int) -> Tensor:
    """Return sums of one to three sines of the distance from a point, (n, 1, h, w), each stretched
    to [0, 1]; up to half a cycle per pixel."""
    y, x = torch.arange(h)[:, None], torch.arange(w)
    margin = 0.08 + 0.84 * torch.rand(2, n, MAX_WAVES, 1, 1)
    distance = ((y - h * margin[0]) ** 2 + (x - w * margin[1]) ** 2).sqrt()
    cycles = torch.randint(1, max(h, w) // 2 + 1, (n, MAX_WAVES, 1, 1))
    waves = (2 * torch.pi * cycles / max(h, w) * distance).sin()
    counted = torch.arange(MAX_WAVES) < torch.randint(1, MAX_WAVES + 1, (n, 1))
    total = (waves * counted[:, :, None, None]).sum(1, keepdim=True)
    low, high = total.amin((2, 3), keepdim=True), total.amax((2, 3), keepdim=True)
    return (total - low) / (high - low)


def augmentations() -> dict[str, Augmentation]:
    """Return what follows crops and flips, by name."""
    moire = RandomMoire(SCENES, p=0.5, shrink=SHRINK)
    twins = map_scenes(as_scenes(SCENES, SHRINK), without_subpixels)
    return {
        "crop and flip": nn.Identity(),
        "RandomMoire": moire,
        "RandomMoire without moiré": RandomMoire(twins, p=0.5),
        "AugMix": augmix,
        "AugMix, RandomMoire": lambda images: moire(augmix(images)),
        "MoireMix": moiremix,
    }
