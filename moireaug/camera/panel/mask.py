"""Where a panel emits: the indicator function of its subpixels, for brute-force sampling."""

from __future__ import annotations

from torch import Tensor

from moireaug.scene.subpixel import Subpixel


def cell_of(subpixel: Subpixel, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Return which copy of a subpixel is nearest to panel position (x, y): whole cells along both
    axes."""
    (cx, cy), (px, py) = subpixel.centre, subpixel.period
    # not `round`, which leaves every second border between two copies to neither
    across = ((x - cx) / px + 0.5).floor()
    down = ((y - cy) / py + 0.5).floor()
    return across, down


def emits(subpixel: Subpixel, x: Tensor, y: Tensor, width: Tensor, height: Tensor) -> Tensor:
    """Return 1 where a copy of a subpixel emits at panel position (x, y), in panel pixels, else 0.
    Not differentiable.

    Args:
        width, height: shares of its two edges that emit, as from `fourier.emitting_share`.
    """
    column, row = cell_of(subpixel, x, y)
    right = x - column * subpixel.period[0] - subpixel.centre[0]
    below = y - row * subpixel.period[1] - subpixel.centre[1]
    (ax, ay), (dx, dy) = subpixel.across, subpixel.down
    turn = ax * dy - ay * dx
    s = (right * dy - below * dx) / turn  # -1/2 to 1/2 along each edge
    t = (below * ax - right * ay) / turn
    return ((s >= -width / 2) & (s < width / 2) & (t >= -height / 2) & (t < height / 2)).to(x.dtype)
