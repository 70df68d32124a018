"""The watermark of watermarks.py: a small encoder and decoder as in StegaStamp (Tancik et al., CVPR
2020) and PIMoG (Fang et al., ACM Multimedia 2022), and the layers that are trained between them,
all written anew."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from kornia.augmentation import RandomJPEG
from kornia.filters import gaussian_blur2d
from torch import Tensor, nn

from moireaug.nn.screen_camera import registered_by

SIDE, BITS = 128, 64  # pixels and bits of a marked image
JITTER = 2.0  # pixels by which corners are misplaced, at most, in all layers but the empty one


class Encoder(nn.Module):
    """Hide bits in images: a U-Net of the image at half resolution and a pattern of the bits."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        self.pattern = nn.Linear(BITS, 8 * 16 * 16)
        self.fine = nn.Conv2d(3, width, 3, padding=1)
        self.coarse = nn.Conv2d(width, 2 * width, 3, 2, 1)
        self.blend = nn.Conv2d(2 * width + 8, 2 * width, 3, padding=1)
        self.residual = nn.Sequential(
            nn.Conv2d(3 * width, width, 3, padding=1), nn.ReLU(), nn.Conv2d(width, 3, 3, padding=1)
        )

    def forward(self, images: Tensor, bits: Tensor, psnr: float) -> Tensor:
        """Return marked images, at `psnr` dB each before values are clamped.

        Args:
            images: (B, 3, SIDE, SIDE) in [0, 1].
            bits: (B, BITS) of 0 and 1.
        """
        fine = F.relu(self.fine(F.avg_pool2d(images, 2) - 0.5))
        pattern = self.pattern(2 * bits - 1).view(-1, 8, 16, 16)
        coarse = F.relu(self.coarse(fine))
        coarse = F.relu(self.blend(torch.cat([coarse, _doubled(pattern)], 1)))
        residual = _doubled(self.residual(torch.cat([fine, _doubled(coarse)], 1)))
        rms = residual.square().mean((1, 2, 3), keepdim=True).add(1e-12).sqrt()
        return (images + 10 ** (-psnr / 20) / rms * residual).clamp(0, 1)


def _doubled(maps: Tensor) -> Tensor:
    return F.interpolate(maps, scale_factor=2, mode="bilinear", align_corners=False)


class Decoder(nn.Sequential):
    """Read bits from images (B, 3, SIDE, SIDE): logits (B, BITS)."""

    def __init__(self, width: int = 24) -> None:
        layers: list[nn.Module] = []
        channels = 3
        for stride, wider in ((2, 1), (2, 2), (1, 2), (2, 3), (1, 3)):
            layers += [nn.Conv2d(channels, width * wider, 3, stride, 1)]
            layers += [nn.GroupNorm(4, width * wider), nn.ReLU()]
            channels = width * wider
        super().__init__(*layers, nn.Flatten(), nn.Linear(channels * 16 * 16, BITS))


class CropBlurJpeg(nn.Module):
    """Cut up to 4 pixels from each side and resize, blur by up to 2 pixels, save as JPEG of quality
    40 to 95."""

    def __init__(self) -> None:
        super().__init__()
        self.jpeg = RandomJPEG(jpeg_quality=(40.0, 95.0), p=1.0)

    def forward(self, images: Tensor) -> Tensor:
        n = len(images)
        left, top, right, bottom = 4 * torch.rand(4, n)
        corners = [(left, top), (-right, top), (-right, -bottom), (left, -bottom)]
        errors = torch.stack([torch.stack(corner, 1) for corner in corners], 1)
        sigma = 0.1 + 1.9 * torch.rand(n, 1).expand(n, 2)
        blurred = gaussian_blur2d(registered_by(images, errors), (9, 9), sigma)
        return self.jpeg(blurred.clamp(0, 1)).clamp(0, 1)


class PimogLike(nn.Module):
    """Distort as PIMoG's noise layer is described: perspective, light that falls off along a line
    or from a point, a pattern of circles and lines, Gaussian noise of variance 0.001; a draw for
    each image."""

    def forward(self, images: Tensor) -> Tensor:
        n, side = len(images), images.shape[-1]
        photos = registered_by(images, JITTER * (2 * torch.rand(n, 4, 2) - 1))
        y, x = torch.meshgrid(2 * [torch.arange(side, dtype=torch.float32)], indexing="ij")
        photos = photos * _light(n, x / side, y / side) + 0.15 * _circles_and_lines(n, x, y)
        return (photos + math.sqrt(0.001) * torch.randn_like(photos)).clamp(0, 1)


def _light(n: int, x: Tensor, y: Tensor) -> Tensor:
    """Return factors (n, 1, H, W) between 0.7 .. 0.9 and 1.1 .. 1.3, of lines or of circles."""
    low, high = (first + 0.2 * torch.rand(n, 1, 1) for first in (0.7, 1.1))
    angle = 2 * math.pi * torch.rand(n, 1, 1)
    line = 0.5 + ((x - 0.5) * angle.cos() + (y - 0.5) * angle.sin()) / math.sqrt(2)
    centre_x, centre_y = torch.rand(2, n, 1, 1)
    circle = 1 - ((x - centre_x).square() + (y - centre_y).square()).sqrt() / math.sqrt(2)
    share = torch.where(torch.rand(n, 1, 1) < 0.5, line, circle)
    return (low + (high - low) * share)[:, None]


def _circles_and_lines(n: int, x: Tensor, y: Tensor) -> Tensor:
    """Return patterns (n, 3, H, W) in [-1, 1], one for each colour."""
    angle = math.pi * torch.rand(n, 3, 1, 1)
    centre_x, centre_y = x.shape[-1] * torch.rand(2, n, 3, 1, 1)
    radius = ((x - centre_x).square() + (y - centre_y).square()).sqrt()
    circles = torch.cos(2 * math.pi * radius)
    return torch.minimum(circles, torch.cos(angle.cos() * x + angle.sin() * y))
