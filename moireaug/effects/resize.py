"""Registration: the photo brought back to the frame of the image that was shown."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from moireaug.effects.view import enlarge, look, nodes, undistortion


def register(photo: Tensor, matrix: Tensor, lens: tuple[Tensor, Tensor] | None, *, affine: bool) -> Tensor:
    """Resample a photo (B, 3, H, W) to the image's frame, bilinear; black where the photo does not show the image.

    Args:
        matrix: (B, 3, 3) from image to ideal photo coordinates. lens: (k1, k2), each (B,), or None.
        affine: the last row of `matrix` is (0, 0, 1).
    """
    h, w = size = photo.shape[-2:]
    rows, cols = (torch.arange(n, dtype=photo.dtype, device=photo.device) + 0.5 for n in size)
    x, y = look(matrix, rows, cols, size, affine=affine, lens=None)
    x, y = x * (2 / w) - 1, y * (2 / h) - 1
    if lens is not None:
        ideal = torch.stack(look(matrix, nodes(rows), nodes(cols), size, affine=affine, lens=None), -1)
        ideal = ideal - ideal.new_tensor([w / 2, h / 2])
        factor = undistortion(ideal.flatten(1, 2), *lens, size).reshape(ideal.shape[:-1]).to(photo.dtype)
        factor = enlarge(factor[:, None], size)[:, 0]
        x, y = x * factor, y * factor
    inside = (x.abs() <= 1) & (y.abs() <= 1)
    grid = torch.stack([x, y], -1)
    return F.grid_sample(photo, grid, padding_mode="border", align_corners=False) * inside[:, None]
