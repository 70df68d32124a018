"""Radial lens distortion, from photo to ideal coordinates and back."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.common.physics.lens import NEWTON_STEPS
from moireaug.common.tensor_physics import lens
from moireaug.scene.geometry.frame import FrameSize


def _per_point(number: float | Tensor, points: Tensor) -> float | Tensor:
    return number[:, None].to(points.dtype) if isinstance(number, Tensor) else number


def radial_factor(points: Tensor, k1: Tensor, k2: Tensor, size: FrameSize) -> Tensor:
    """Return the factor 1 + k1 r^2 + k2 r^4 at photo points (B, N, 2) measured from the centre;
    r = 1 in corners."""
    r2 = points.square().sum(-1) * _per_point(4 / (size[0] ** 2 + size[1] ** 2), points)
    return lens.radial_factor(r2, k1[:, None], k2[:, None])


def inverse_radial_factor(points: Tensor, k1: Tensor, k2: Tensor, size: FrameSize) -> Tensor:
    """Return the factor (B, N) that takes ideal points (B, N, 2), measured from the photo's centre,
    to photo points: the inverse of the lens, by Newton steps; beyond the photo's corners, where the
    polynomial may fold, by its tangent there."""
    half_diagonal = _per_point((size[0] ** 2 + size[1] ** 2) ** 0.5 / 2, points)
    k1, k2 = k1[:, None], k2[:, None]
    ideal = points.norm(dim=-1) / half_diagonal
    beyond = lens.tangent_radius(ideal, k1, k2)
    with torch.no_grad():
        r = lens.newton_start(ideal, k1, k2)
        for _ in range(NEWTON_STEPS):
            r = lens.newton_step(r, ideal, k1, k2)
    # one step with a gradient is exact for the first derivative, two are for the second
    for _ in range(2):
        r = lens.newton_step(r, ideal, k1, k2)
    r = torch.where(beyond > 1, beyond, r)
    tiny = ideal < 1e-12
    return torch.where(tiny, 1.0, r / torch.where(tiny, 1.0, ideal))
