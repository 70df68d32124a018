"""Where a photo's points look, in numpy, for all cameras of a batch at once. `cpu.view` does the
same for one point in numba, which would compile for seconds where Triton needs none of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from moireaug.common.physics import lens
from moireaug.engine.lower.exposure_records import Camera
from moireaug.scene.geometry.distortion import inverse_radial_factor

Arrays = tuple[np.ndarray, ...]


def cameras_of(cameras: np.ndarray) -> Any:
    """Return the fields (B, fields) of a batch's cameras as one Camera of arrays (B, 1, 1), which
    broadcast over points."""
    return Camera(*cameras.T[:, :, None, None])


def jacobian(u: np.ndarray, v: np.ndarray, c: Any) -> Arrays:
    """Return `lens.panel_jacobian`, (B, h, w) each, at photo points about the centre; of rectified
    cameras, at where the photos show image points. c: from `cameras_of`."""
    if c.rectified.any():
        u, v = to_photo(u, v, c)
    return lens.panel_jacobian(u, v, c)


def to_photo(x: np.ndarray, y: np.ndarray, c: Any) -> Arrays:
    """Return where image points lie on the photos, both about the centre, (B, h, w) each."""
    u, v = lens.project(x, y, forward(c).reshape(-1, 9).T[:, :, None, None])
    if c.k1.any() or c.k2.any():
        points = torch.from_numpy(np.stack([u, v], -1).reshape(len(u), -1, 2))
        fields = (c.k1, c.k2, c.photo_height, c.photo_width)
        k1, k2, height, width = (torch.from_numpy(field[:, 0, 0]) for field in fields)
        factor = inverse_radial_factor(points, k1, k2, (height, width)).numpy().reshape(u.shape)
        u, v = u * factor, v * factor
    return u, v


def forward(c: Any) -> np.ndarray:
    """Return the homographies from image to ideal photo coordinates, (B, 3, 3)."""
    return np.linalg.inv(np.stack(c[:9], -1).reshape(-1, 3, 3))
