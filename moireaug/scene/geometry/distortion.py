"""Radial lens distortion, from photo to ideal coordinates and back."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.scene.geometry.frame import FrameSize
from moireaug.scene.lens import MIN_LENS_SLOPE

NEWTON_STEPS = 8


def _per_point(number: float | Tensor, points: Tensor) -> float | Tensor:
    return number[:, None].to(points.dtype) if isinstance(number, Tensor) else number


def radial_factor(points: Tensor, k1: Tensor, k2: Tensor, size: FrameSize) -> Tensor:
    """Return the factor 1 + k1 r^2 + k2 r^4 at photo points (B, N, 2) measured from the centre;
    r = 1 in corners."""
    r2 = points.square().sum(-1) * _per_point(4 / (size[0] ** 2 + size[1] ** 2), points)
    return 1 + r2 * (k1[:, None] + k2[:, None] * r2)


def inverse_radial_factor(points: Tensor, k1: Tensor, k2: Tensor, size: FrameSize) -> Tensor:
    """Return the factor (B, N) that takes ideal points (B, N, 2), measured from the photo's centre,
    to photo points: the inverse of the lens, by Newton steps.

    Beyond the photo's corners (r > 1), where the polynomial may fold, its tangent at r = 1 is
    followed instead.
    """
    half_diagonal = _per_point((size[0] ** 2 + size[1] ** 2) ** 0.5 / 2, points)
    k1, k2 = k1[:, None], k2[:, None]
    ideal = points.norm(dim=-1) / half_diagonal
    slope = 1 + 3 * k1 + 5 * k2
    beyond = 1 + (ideal - 1 - k1 - k2) / slope

    def newton(r: Tensor) -> Tensor:
        r2 = r * r
        error = r * (1 + r2 * (k1 + k2 * r2)) - ideal
        slope_here = (1 + r2 * (3 * k1 + 5 * k2 * r2)).clamp(min=MIN_LENS_SLOPE)
        return (r - error / slope_here).clamp(min=0, max=1)

    with torch.no_grad():
        # steps that begin where the curve's bend changes sign never go back and forth for good
        turn = -0.3 * k1 / k2
        r = torch.where((turn > 0) & (turn < 1), turn.sqrt(), ideal.clamp(min=0, max=1))
        for _ in range(NEWTON_STEPS):
            r = newton(r)
    # one step with a gradient is exact for the first derivative, two are for the second
    r = torch.where(beyond > 1, beyond, newton(newton(r)))
    tiny = ideal < 1e-12
    return torch.where(tiny, 1.0, r / torch.where(tiny, 1.0, ideal))
