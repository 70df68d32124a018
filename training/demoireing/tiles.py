"""Run a network on images of any size, tile by tile."""

from collections.abc import Callable

import torch
from torch import Tensor

TILE_SIDE, TILE_OVERLAP = 768, 128  # pixels; half an overlap suits every network's `multiple`


def tiled(
    network: Callable[[Tensor], Tensor],
    images: Tensor,
    side: int = TILE_SIDE,
    overlap: int = TILE_OVERLAP,
) -> Tensor:
    """Return a network's output for images of any size, computed tile by tile.

    Neighbouring tiles overlap and are blended: of the overlap the outer quarters are dropped, and
    the halves between fade into one another. So the result is that of the whole image where a pixel
    depends on no others farther off than a quarter of the overlap. A network that takes means over
    its whole input, as ESDNet does, takes those of each tile.

    Args:
        network: takes images (B, 3, h, w) in [0, 1] and returns the same shape.
        images: (B, 3, H, W). Where H and W are at most `side`, the network gets them whole.
        side: of a tile, in pixels, at least twice the overlap.
        overlap: of neighbouring tiles, in pixels, at least; a multiple of 4. The side and half the
            overlap should be multiples of the network's `multiple`, so that a tile lies on the grid
            of the whole.

    Returns:
        (B, 3, H, W), on the images' device; besides it, memory is that of one tile.
    """
    height, width = images.shape[-2:]
    if max(height, width) <= side:
        return network(images)
    total = torch.zeros_like(images)
    weight = images.new_zeros(height, width)
    for top, bottom in spans(height, side, overlap):
        rows = _fade(top, bottom, height, overlap).to(images)
        for left, right in spans(width, side, overlap):
            columns = _fade(left, right, width, overlap).to(images)
            share = rows[:, None] * columns
            output = network(images[..., top:bottom, left:right])
            total[..., top:bottom, left:right] += share * output
            weight[top:bottom, left:right] += share
    return total / weight


def spans(length: int, side: int, overlap: int) -> list[tuple[int, int]]:
    """Return where tiles begin and end along an axis. The last one begins earlier, so that it is
    about as long as the others."""
    ends = []
    start = 0
    while start + side < length:
        ends.append((start, start + side))
        start += side - overlap
    grid = overlap // 2
    last = max(0, -(-(length - side) // grid) * grid)
    ends.append((min(start, last), length))
    return ends


def _fade(first: int, last: int, length: int, overlap: int) -> Tensor:
    """Return the weights of a tile's pixels along an axis, which fade towards its neighbours."""
    position = torch.arange(first, last, dtype=torch.float64, device="cpu") + 0.5
    weights = torch.ones_like(position)
    if first > 0:
        weights = _ramp(position - first, overlap)
    if last < length:
        weights = weights * _ramp(last - position, overlap)
    return weights


def _ramp(distance: Tensor, overlap: int) -> Tensor:
    return ((distance - overlap / 4) / (overlap / 2)).clamp(0, 1)
