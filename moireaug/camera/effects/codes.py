"""Photos as 8-bit codes, for file formats and OpenCV."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from moireaug.common.numeric import has_func_gradient


def to_codes(photo: Tensor) -> np.ndarray:
    """Return (B, 3, H, W) float in [0, 1] as the nearest 8-bit codes, (B, H, W, 3) uint8 on the
    CPU.

    Raises:
        ValueError: the photo holds NaN, which has no code.
    """
    if photo.isnan().any():
        raise ValueError(
            "the photo holds NaN, which has no 8-bit code. Look for it in the image or the noise."
        )
    codes = (photo * 255).round().clamp(0, 255).to(torch.uint8)
    return codes.permute(0, 2, 3, 1).contiguous().cpu().numpy()


def check_only_backward(photo: Tensor, name: str) -> None:
    """Refuse a forward derivative, which would be 0, as codes are whole numbers, and those of
    `torch.func`, which have no way through the codec."""
    if torch.compiler.is_compiling():
        return
    if forward_ad.unpack_dual(photo).tangent is not None:
        raise NotImplementedError(
            f"{name} has no forward derivative. Use backward, or a scene without it."
        )
    if has_func_gradient(photo):
        raise NotImplementedError(
            f"{name} has no derivative by torch.func. Use torch.autograd.grad or backward, or a "
            "scene without it."
        )


def from_codes(codes: Iterable[np.ndarray], like: Tensor) -> Tensor:
    """Return the inverse of `to_codes`: from (H, W, 3) uint8 for each image, a new photo of the
    shape, dtype and device of `like`."""
    photo = torch.empty(like.shape, dtype=torch.uint8, device="cpu")
    for row, image in zip(photo, codes, strict=True):
        row.copy_(torch.from_numpy(image).permute(2, 0, 1))
    return photo.to(like.device).to(like.dtype) / 255
