"""The paper's released chain, step by step on every sensor pixel: `paper_code` must equal it, and
be faster.

Along each axis: three panel pixels per image pixel, three subpixels per panel pixel, one sensor
pixel per subpixel.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from kornia.geometry.transform import warp_perspective
from torch import Tensor

ALPHA, SUBPIXELS = 3, 3
SCALE = ALPHA * SUBPIXELS
BAYER = ((0, 0, 0), (1, 0, 1), (1, 1, 0), (2, 1, 1))  # channel, row and column of the RGGB cell


def photograph(
    image: Tensor, homography: Tensor, noise: Tensor | float = 0.0, brighten: float = 0.0
) -> Tensor:
    """Return photos of images (B, 3, H, W) in [0, 1], of the same shape.

    Args:
        homography: (B, 3, 3), image to photo, as `Shot.matrix` has it.
        noise: added to the reading.
        brighten: added before the photo is clipped.
    """
    return develop(expose(image, homography) + noise, tuple(image.shape[-2:]), brighten)


def expose(image: Tensor, homography: Tensor) -> Tensor:
    """Return the reading of every sensor pixel, (B, 3, 9 H, 9 W) with each pixel's one colour, the
    others 0."""
    panel = F.interpolate(image, scale_factor=ALPHA, mode="bilinear", align_corners=False)
    return mosaic(warp(subpixels(panel), homography))


def develop(sensor: Tensor, size: tuple[int, int], brighten: float = 0.0) -> Tensor:
    photo = (demosaic(sensor) + brighten).clamp(0, 1)
    return F.interpolate(photo, size=size, mode="bilinear", align_corners=False)


def subpixels(panel: Tensor) -> Tensor:
    """Turn each panel pixel into 3 x 3 subpixels, of which column j is lit in channel j alone."""
    raster = panel.repeat_interleave(SUBPIXELS, -1).repeat_interleave(SUBPIXELS, -2)
    lit = torch.eye(SUBPIXELS, dtype=panel.dtype, device=panel.device).repeat(1, panel.shape[-1])
    return raster * lit[:, None]


def warp(raster: Tensor, homography: Tensor) -> Tensor:
    """Warp bilinearly, black outside; the homography is in pixel indices of the raster."""
    to_index = homography.new_tensor([[SCALE, 0, -0.5], [0, SCALE, -0.5], [0, 0, 1]])
    matrix = to_index @ homography @ torch.linalg.inv(to_index)
    return warp_perspective(raster, matrix.to(raster), tuple(raster.shape[-2:]), align_corners=True)


def mosaic(colours: Tensor) -> Tensor:
    """Return (B, 3, h, w) with each pixel's one colour kept, the others 0."""
    kept = torch.zeros_like(colours)
    for channel, row, column in BAYER:
        kept[:, channel, row::2, column::2] = colours[:, channel, row::2, column::2]
    return kept


def demosaic(kept: Tensor) -> Tensor:
    """Demosaic bilinearly with zero padding."""
    cross = kept.new_tensor([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
    square = kept.new_tensor([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    return F.conv2d(kept, torch.stack([square, cross, square])[:, None], padding=1, groups=3)
