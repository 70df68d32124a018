"""The fifteen common corruptions of Hendrycks and Dietterich at five severities, for images of
32 px: batched, with the amounts of CIFAR-10-C.

Packages that make them, such as imagecorruptions and corrupt-tta, have the amounts of ImageNet-C,
which are for 224 px. Photos of frost come with corrupt-tta; without it frost is left out.

Source: D. Hendrycks and T. Dietterich, "Benchmarking Neural Network Robustness to Common
Corruptions and Perturbations" (2019), and the amounts of their published CIFAR-10-C.
"""

from __future__ import annotations

import functools
import importlib.util
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from kornia.filters import filter2d, gaussian_blur2d
from PIL import Image
from torch import Tensor
from torchvision.transforms import v2
from torchvision.transforms.v2 import functional as tv

from moireaug.common.image_files import read_picture
from moireaug.defenses import JPEG

FROST_PHOTOS, FROST_SCALE = 5, 0.2  # of the six that there are, as in the published script


def blur(x: Tensor, sigma: float) -> Tensor:
    """Blur by a Gaussian of `sigma` pixels, with the edge's colour around the image."""
    half = max(1, int(4 * sigma + 0.5))
    return gaussian_blur2d(x, 2 * half + 1, (sigma, sigma), "replicate")


def gaussian_noise(x: Tensor, sigma: float) -> Tensor:
    return x + sigma * torch.randn_like(x)


def shot_noise(x: Tensor, photons: float) -> Tensor:
    return torch.poisson(x * photons) / photons


def impulse_noise(x: Tensor, share: float) -> Tensor:
    return torch.where(torch.rand_like(x) < share, torch.rand_like(x).round(), x)


def defocus_blur(x: Tensor, radius: float, edge: float) -> Tensor:
    """Blur by a disc whose edge is a Gaussian of standard deviation `edge`."""
    axis = torch.arange(-3, 4)
    disc = (axis[:, None] ** 2 + axis**2 <= radius**2).float()
    disc = gaussian_blur2d((disc / disc.sum())[None, None], 3, (edge, edge))
    return filter2d(x, disc[0], "reflect")


def glass_blur(x: Tensor, sigma: float, passes: int) -> Tensor:
    """Blur, have each pixel repeat itself or a neighbour above or to the left, and blur. The
    published script means to swap the two, and does this."""
    n, channels, height, width = x.shape
    x = blur(x, sigma)
    for _ in range(passes):
        up, left = torch.randint(0, 2, (2, n, height, width))
        up[:, :2], up[:, :, :2], left[:, :2], left[:, :, :2] = 0, 0, 0, 0
        index = (torch.arange(height)[:, None] - up) * width + torch.arange(width) - left
        x = x.flatten(2).gather(2, index.flatten(1)[:, None].expand(-1, channels, -1)).view_as(x)
    return blur(x, sigma)


def motion(x: Tensor, taps: int, sigma: float, angle: Tensor) -> Tensor:
    """Smear along `angle` (B,), in radians, with half a Gaussian of `sigma` pixels for weights."""
    side, images = x.shape[-1], torch.arange(len(x))[:, None, None]
    weights = torch.exp(-(torch.arange(2 * taps + 1) ** 2) / (2 * sigma**2))
    weights /= weights.sum()
    smeared = torch.zeros_like(x)
    for k, weight in enumerate(weights.tolist()):
        down, right = (torch.ceil(k * f(angle) - 0.5).long() for f in (torch.sin, torch.cos))
        rows = (torch.arange(side) + down[:, None]).clamp(0, side - 1)[:, :, None]
        columns = (torch.arange(side) + right[:, None]).clamp(0, side - 1)[:, None]
        smeared += weight * x.movedim(1, 3)[images, rows, columns].movedim(3, 1)
    return smeared


def motion_blur(x: Tensor, taps: int, sigma: float) -> Tensor:
    angle = math.pi / 4 * (2 * torch.rand(len(x)) - 1)
    return motion(x, taps, sigma, angle)


def zoomed(x: Tensor, factor: float) -> Tensor:
    """Enlarge the middle of square images."""
    side, part = x.shape[-1], math.ceil(x.shape[-1] / factor)
    top = (side - part) // 2
    middle, large = tv.crop(x, top, top, part, part), round(part * factor)
    middle = F.interpolate(middle, size=large, mode="bilinear", align_corners=True)
    return tv.crop(middle, (large - side) // 2, (large - side) // 2, side, side)


def zoom_blur(x: Tensor, percent: int) -> Tensor:
    """Average images with themselves, enlarged by 0, 1, ... `percent` percent."""
    views = [zoomed(x, 1 + k / 100) for k in range(percent + 1)]
    return (x + sum(views)) / (len(views) + 1)


def snow(x: Tensor, flakes: tuple[float, float, float, float], fall: tuple, keep: float) -> Tensor:
    """Whiten images by all but a share `keep`, and let flakes fall in two directions: noise of a
    mean and a deviation, enlarged, above a least value, smeared by taps and deviation `fall`."""
    mean, deviation, zoom, least = flakes
    layer = zoomed(mean + deviation * torch.randn_like(x[:, :1]), zoom)
    layer = torch.where(layer < least, 0, layer).clamp(0, 1)
    layer = motion(layer, *fall, math.pi * (-0.75 + 0.5 * torch.rand(len(x))))
    white = 1.5 * tv.rgb_to_grayscale(x) + 0.5
    return keep * x + (1 - keep) * torch.maximum(x, white) + layer + layer.rot90(2, (2, 3))


@functools.lru_cache
def frost_photos() -> list[Tensor]:
    """Return photos of frost (3, H, W), none where corrupt-tta is not installed."""
    found = importlib.util.find_spec("corrupt_tta")
    if not found or not found.origin:
        return []
    files = sorted((Path(found.origin).parent / "assets/frost").glob("frost*"))
    photos = [tv.pil_to_tensor(read_picture(file))[None] / 255 for file in files[:FROST_PHOTOS]]
    return [F.interpolate(one, scale_factor=FROST_SCALE, mode="bilinear")[0] for one in photos]


def frost(x: Tensor, keep: float, ice: float) -> Tensor:
    crop, chosen = v2.RandomCrop(x.shape[-1]), torch.randint(0, FROST_PHOTOS, (len(x),))
    return keep * x + ice * torch.stack([crop(frost_photos()[k]) for k in chosen.tolist()])


def plasma(n: int, side: int, decay: float) -> Tensor:
    """Return clouds (n, side, side) in [0, 1] by the diamond-square algorithm; `side` is a power of
    two, and details half as large are weaker by `decay` squared."""
    field, step, strength = torch.zeros(n, side, side), side, 1.0

    def displaced(total: Tensor) -> Tensor:
        return total / 4 + strength * (2 * torch.rand_like(total) - 1)

    while step >= 2:
        half = step // 2
        corners = field[:, ::step, ::step]
        pairs = corners + corners.roll(-1, 1)
        field[:, half::step, half::step] = displaced(pairs + pairs.roll(-1, 2))
        middles = field[:, half::step, half::step]
        beside = corners + corners.roll(-1, 2) + middles + middles.roll(1, 1)
        above = corners + corners.roll(-1, 1) + middles + middles.roll(1, 2)
        field[:, ::step, half::step] = displaced(beside)
        field[:, half::step, ::step] = displaced(above)
        step, strength = half, strength / decay**2
    field -= field.amin((1, 2), keepdim=True)
    return field / field.amax((1, 2), keepdim=True)


def fog(x: Tensor, amount: float, decay: float) -> Tensor:
    brightest = x.amax((1, 2, 3), keepdim=True)
    clouds = plasma(len(x), x.shape[-1], decay)[:, None]
    return (x + amount * clouds) * brightest / (brightest + amount)


def brightness(x: Tensor, amount: float) -> Tensor:
    """Raise the value of HSV, with hue and saturation as they were."""
    value = x.amax(1, keepdim=True)
    return torch.where(value > 0, x / value.clamp(min=1e-6), 1) * (value + amount).clamp(max=1)


def contrast(x: Tensor, factor: float) -> Tensor:
    mean = x.mean((2, 3), keepdim=True)
    return (x - mean) * factor + mean


def elastic(x: Tensor, strength: float, sigma: float, corners: float) -> Tensor:
    """Move three points of images by up to `corners` pixels, and all others with them; then each
    pixel by noise, blurred by `sigma` pixels and multiplied by `strength`."""
    n, _, side, _ = x.shape
    triangle = side // 3 * torch.tensor([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]) + side // 2
    moved = triangle + corners * (2 * torch.rand(n, 3, 2) - 1)
    back = torch.linalg.solve(F.pad(moved, (0, 1), value=1.0), triangle.expand(n, 3, 2))
    grid = torch.cartesian_prod(torch.arange(side), torch.arange(side)).flip(1).view(side, side, 2)
    x = sampled(x, F.pad(grid.float(), (0, 1), value=1.0) @ back[:, None])
    if strength == 0:
        return x
    shift = strength * blur(2 * torch.rand(n, 2, side, side) - 1, sigma)
    return sampled(x, grid + shift.movedim(1, 3))


def sampled(x: Tensor, places: Tensor) -> Tensor:
    """Return images at places (B, H, W, 2), x and y in pixels, mirrored at their edges."""
    relative = 2 * places / (x.shape[-1] - 1) - 1
    return F.grid_sample(x, relative, padding_mode="reflection", align_corners=True)


def pixelate(x: Tensor, scale: float) -> Tensor:
    side, small, box = x.shape[-1], int(scale * x.shape[-1]), Image.Resampling.BOX
    coarse = [tv.to_pil_image(one).resize((small, small), box) for one in x]
    return torch.stack([tv.pil_to_tensor(one.resize((side, side), box)) for one in coarse]) / 255


def jpeg(x: Tensor, quality: int) -> Tensor:
    return JPEG(quality)(x)


Corruption = Callable[..., Tensor]
# groups of functions, and the arguments of each at five severities
CORRUPTIONS: dict[str, dict[Corruption, list[Any]]] = {
    "noise": {
        gaussian_noise: [0.04, 0.06, 0.08, 0.09, 0.1],
        shot_noise: [500, 250, 100, 75, 50],
        impulse_noise: [0.01, 0.02, 0.03, 0.05, 0.07],
    },
    "blur": {
        defocus_blur: [(0.3, 0.4), (0.4, 0.5), (0.5, 0.6), (1, 0.2), (1.5, 0.1)],
        glass_blur: [(0.05, 1), (0.25, 1), (0.4, 1), (0.25, 2), (0.4, 2)],
        motion_blur: [(6, 1), (6, 1.5), (6, 2), (8, 2), (9, 2.5)],
        zoom_blur: [6, 11, 15, 20, 25],
    },
    "weather": {
        snow: [
            ((0.1, 0.2, 1, 0.6), (8, 3), 0.95),
            ((0.1, 0.2, 1, 0.5), (10, 4), 0.9),
            ((0.15, 0.3, 1.75, 0.55), (10, 4), 0.9),
            ((0.25, 0.3, 2.25, 0.6), (12, 6), 0.85),
            ((0.3, 0.3, 1.25, 0.65), (14, 12), 0.8),
        ],
        frost: [(1, 0.2), (1, 0.3), (0.9, 0.4), (0.85, 0.4), (0.75, 0.45)],
        fog: [(0.2, 3), (0.5, 3), (0.75, 2.5), (1, 2), (1.5, 1.75)],
        brightness: [0.05, 0.1, 0.15, 0.2, 0.3],
    },
    "digital": {
        contrast: [0.75, 0.5, 0.4, 0.3, 0.15],
        elastic: [(0, 0, 2.6), (1.6, 6.4, 2.2), (2.6, 1.9, 1.9), (3.2, 1.3, 1.6), (3.2, 1, 1)],
        pixelate: [0.95, 0.9, 0.85, 0.75, 0.65],
        jpeg: [80, 65, 58, 50, 40],
    },
}


def corrupt(images: Tensor, change: Corruption, amount: Any, seed: int = 0) -> Tensor:
    """Return corrupted images, (B, 3, H, H) uint8, each by a draw of its own.

    Args:
        images: (B, 3, H, H) uint8; the amounts are for 32 px. change, amount: of `CORRUPTIONS`.
    """
    amounts = amount if isinstance(amount, tuple) else (amount,)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        corrupted = change(images / 255, *amounts)
    return (255 * corrupted.clamp(0, 1)).round().byte()
