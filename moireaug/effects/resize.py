"""Registration: the photo brought back to the frame of the image that was shown."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.effects.exposure import shown
from moireaug.effects.view import enlarge, look, nodes, undistortion


def unbent(matrix: Tensor, lens: tuple[Tensor, Tensor] | None, size: tuple[int, int], *, affine: bool) -> Tensor | None:
    """The factor that undoes the lens, on `nodes` of the image: (B, 1, n, n), or None without a lens."""
    if lens is None:
        return None
    h, w = size
    rows, cols = (nodes(torch.arange(n, dtype=torch.float64, device=matrix.device) + 0.5) for n in size)
    ideal = torch.stack(look(matrix, rows, cols, size, affine=affine, lens=None), -1)
    ideal = ideal - ideal.new_tensor([w / 2, h / 2])
    return undistortion(ideal.flatten(1, 2), *lens, size).reshape(ideal.shape[:-1])[:, None]


def register(photo: Tensor, matrix: Tensor, factor: Tensor | None, *, affine: bool) -> Tensor:
    """Resample a photo (B, 3, H, W) to the image's frame, bilinear; black where the photo does not show the image.

    Args:
        matrix: (B, 3, 3) from image to ideal photo coordinates. factor: as from `unbent`.
        affine: the last row of `matrix` is (0, 0, 1).
    """
    h, w = size = photo.shape[-2:]
    rows, cols = (torch.arange(n, dtype=photo.dtype, device=photo.device) + 0.5 for n in size)
    to_edges = matrix.new_tensor([2 / w, 2 / h, 1])[:, None]  # the photo goes from -1 to 1
    x, y = (t - 1 for t in look(to_edges * matrix, rows, cols, size, affine=affine, lens=None))
    if factor is not None:
        factor = enlarge(factor.to(photo.dtype), size)[:, 0]
        x, y = x * factor, y * factor
    inside = torch.maximum(x.detach().abs(), y.detach().abs()) <= 1
    return shown(photo, x, y, dark=False) * inside.to(photo.dtype)[:, None]
