"""Images on a device, their colours, and which of their pixels a program computes.

All programs lie along the grid's first axis: the others end at 65,535.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import triton
import triton.language as tl
from torch import Tensor

TILE = (8, 32)  # rows and columns of pixels that a program computes


class Images(NamedTuple):
    """Images, (B, channels, height, width) float32, contiguous."""

    pointer: Any
    height: int
    width: int


class Pixels(NamedTuple):
    """Pixels of one image.

    Args:
        image: its index, int64. row, col: int32, which broadcast to a tile. exist: whether the
            image has them, bool.
    """

    image: Any
    row: Any
    col: Any
    exist: Any


@triton.jit
def tile(images, TILE: tl.constexpr):
    """Return the Pixels of a program's tile."""
    down = (images.height + TILE[0] - 1) // TILE[0]
    across = (images.width + TILE[1] - 1) // TILE[1]
    index = tl.program_id(0)
    row = index // across % down * TILE[0] + tl.arange(0, TILE[0])[:, None]
    col = index % across * TILE[1] + tl.arange(0, TILE[1])[None, :]
    image = (index // (across * down)).to(tl.int64)
    return Pixels(image, row, col, (row < images.height) & (col < images.width))


@triton.jit
def block(count, BLOCK: tl.constexpr):
    """Return the index of a program's group, of those of `count` values each, and the indices of
    its BLOCK values, of which the last may be beyond `count`; int32."""
    blocks = (count + BLOCK - 1) // BLOCK
    first = tl.program_id(0) % blocks * BLOCK
    return tl.program_id(0) // blocks, first + tl.arange(0, BLOCK)


@triton.jit
def address(images, pixels, CHANNELS: tl.constexpr):
    """Return pointers to pixels of the first of an image's channels."""
    image = images.pointer + pixels.image * CHANNELS * images.height * images.width
    return image + pixels.row * images.width + pixels.col


@triton.jit
def load(images, pixels):
    """Return the colours of pixels, 0 for those that do not exist."""
    at, plane = address(images, pixels, 3), images.height * images.width
    red = tl.load(at, mask=pixels.exist, other=0.0)
    green = tl.load(at + plane, mask=pixels.exist, other=0.0)
    return red, green, tl.load(at + 2 * plane, mask=pixels.exist, other=0.0)


@triton.jit
def store(images, pixels, colours):
    """Store the colours of pixels."""
    at, plane = address(images, pixels, 3), images.height * images.width
    for channel in tl.static_range(3):
        tl.store(at + channel * plane, colours[channel], mask=pixels.exist)


@triton.jit
def black(like):
    """Return colours without light, of the shape of others."""
    none = tl.full(like.shape, 0.0, tl.float32)
    return none, none, none


@triton.jit
def add(total, weight, colours):
    """Return colours to which weighted ones are added."""
    return (
        total[0] + weight * colours[0],
        total[1] + weight * colours[1],
        total[2] + weight * colours[2],
    )


@triton.jit
def clip(x):
    """Return x in [0, 1]."""
    return tl.minimum(tl.maximum(x, 0.0), 1.0)


@triton.jit
def clip_back(grad, x):
    """Return the gradient in x, from that in its clip: the same at 0 and 1, too, 0 beyond."""
    return tl.where((x >= 0.0) & (x <= 1.0), grad, 0.0)


def launch(kernel: Any, out: Tensor, *arguments: Any, **constants: Any) -> None:
    """Run a kernel, a program for each tile of out (B, C, H, W), which it fills.

    Args:
        arguments: the kernel's. It takes tensors as `Images`. constants: it is compiled with them.
    """
    count, _, height, width = out.shape
    given = [
        Images(value, *value.shape[2:]) if isinstance(value, Tensor) else value
        for value in (out, *arguments)
    ]
    programs = count * triton.cdiv(height, TILE[0]) * triton.cdiv(width, TILE[1])
    kernel[(programs,)](*given, **constants, TILE=TILE)
