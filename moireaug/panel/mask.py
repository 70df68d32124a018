"""Where a panel emits: the indicator function of its subpixels, for brute-force sampling."""

from __future__ import annotations

from torch import Tensor

from moireaug.scene.layout import Subpixel


def cell_of(
    subpixel: Subpixel, period: tuple[int, int], x: Tensor, y: Tensor
) -> tuple[Tensor, Tensor]:
    """Return which copy of a subpixel is nearest to panel position (x, y): whole cells along both
    axes."""
    across = ((x - subpixel.centre[0]) / period[0]).round()
    down = ((y - subpixel.centre[1]) / period[1]).round()
    return across, down


def emits(
    subpixel: Subpixel, period: tuple[int, int], x: Tensor, y: Tensor, width: Tensor, height: Tensor
) -> Tensor:
    """Return 1 where a copy of a subpixel emits at panel position (x, y), in panel pixels, else 0.
    Not differentiable.

    Args:
        width, height: shares of its two edges that emit, as from `fourier.emitting_share`.
    """
    column, row = cell_of(subpixel, period, x, y)
    right = x - column * period[0] - subpixel.centre[0]
    below = y - row * period[1] - subpixel.centre[1]
    (ax, ay), (dx, dy) = subpixel.across, subpixel.down
    turn = ax * dy - ay * dx
    s = (right * dy - below * dx) / turn  # -1/2 to 1/2 along each edge
    t = (below * ax - right * ay) / turn
    return ((s >= -width / 2) & (s < width / 2) & (t >= -height / 2) & (t < height / 2)).to(x.dtype)
