"""Which pixels a program computes: a tile of one image's."""

from __future__ import annotations

from typing import Any

import triton
import triton.language as tl
from torch import Tensor

TILE = {"ROWS": 8, "COLS": 32}  # pixels


@triton.jit
def tile(size, ROWS: tl.constexpr, COLS: tl.constexpr):
    """Return the image, int64, and the rows (ROWS, 1) and columns (1, COLS) of a program's tile,
    and which of its pixels an image of this size has."""
    row = tl.program_id(1) * ROWS + tl.arange(0, ROWS)[:, None]
    col = tl.program_id(0) * COLS + tl.arange(0, COLS)[None, :]
    return tl.program_id(2).to(tl.int64), row, col, (row < size[0]) & (col < size[1])


@triton.jit
def load_colours(photo, row, col, size, exists):
    """Return the colours of an image's pixels, planes (3, *size)."""
    height, width = size
    at = photo + row * width + col
    red = tl.load(at, mask=exists, other=0.0)
    green = tl.load(at + height * width, mask=exists, other=0.0)
    blue = tl.load(at + 2 * height * width, mask=exists, other=0.0)
    return red, green, blue


@triton.jit
def store_colours(photo, image, row, col, size, inside, red, green, blue):
    """Store colours in photo (B, 3, *size)."""
    height, width = size
    at = photo + (image * 3 * height + row) * width + col
    tl.store(at, red, mask=inside)
    tl.store(at + height * width, green, mask=inside)
    tl.store(at + 2 * height * width, blue, mask=inside)


def launch(kernel: Any, out: Tensor, *arguments: Any, **constants: Any) -> None:
    """Run a kernel, one program for each tile of out (B, C, H, W), which it fills.

    constants: what the kernel is compiled with.
    """
    count, _, height, width = out.shape
    grid = (triton.cdiv(width, TILE["COLS"]), triton.cdiv(height, TILE["ROWS"]), count)
    kernel[grid](out, *arguments, **constants, **TILE)


def size_of(images: Tensor) -> tuple[int, int]:
    """Return the height and width of images (B, C, H, W)."""
    return images.shape[2], images.shape[3]
