"""Pictures as 8-bit codes: tensors (3, H, W) uint8, PIL's images, and what JPEG makes of them."""

import io

import numpy as np
import torch
from PIL import Image
from torch import Tensor


def codes_of(picture: Image.Image) -> Tensor:
    """Return the codes of a picture in mode RGB, (3, H, W) uint8."""
    return torch.from_numpy(np.array(picture)).permute(2, 0, 1)


def picture_of(codes: Tensor) -> Image.Image:
    """Return codes (3, H, W) uint8 as a picture."""
    return Image.fromarray(codes.permute(1, 2, 0).contiguous().numpy())


def rounded(photos: Tensor) -> Tensor:
    """Return photos in [0, 1] as codes, uint8 of the same shape, as files hold them."""
    return (255 * photos).round().clamp(0, 255).to(torch.uint8)


def through_jpeg(picture: Image.Image, quality: int) -> Image.Image:
    """Return a picture as a JPEG file of a quality from 1 to 100 holds it."""
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=quality)
    return Image.open(file).convert("RGB")
