"""Points and masks of an image, moved to where the photo shows them."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.scene.geometry import grids
from moireaug.scene.geometry.frame import Frame


def points_in_photo(
    points: Tensor, matrix: Tensor, frame: Frame, distortion: grids.RadialCoefficients | None
) -> Tensor:
    """Return where points (B, N, 2) of the image lie in the photo, x then y in pixels, float64.

    Args:
        matrix, frame, distortion: of the shot.
    """
    image_points = points + frame.image_corner(points)
    moved = grids.image_to_photo(image_points, matrix, frame.size, distortion)
    return moved - frame.photo_corner(moved)


def mask_in_photo(
    mask: Tensor, matrix: Tensor, frame: Frame, distortion: grids.RadialCoefficients | None
) -> Tensor:
    """Return a mask (B, C, H, W) of the image as in the photo: nearest pixel, 0 off the image;
    the rest as in `points_in_photo`."""
    h, w = mask.shape[-2:]
    centres = grids.pixel_centres((h, w), mask.device)
    photo_points = centres + frame.photo_corner(centres)
    inverse = torch.linalg.inv(matrix)
    image_points = grids.photo_to_image(photo_points, inverse, frame.size, distortion)
    x, y = (image_points - frame.image_corner(image_points)).unbind(-1)
    on = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    flat = torch.where(on, y.floor() * w + x.floor(), 0).long()[:, None].flatten(2)
    taken = mask.flatten(2).gather(2, flat.expand(-1, mask.shape[1], -1)).reshape(mask.shape)
    return torch.where(on[:, None], taken, torch.zeros_like(taken))
