"""Where a photo's points look, in numpy, for all cameras of a batch at once. `cpu.view` does the
same for one point in numba, which would compile for seconds where Triton needs none of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from moireaug.engine.lower.budget import MAX_LENS_RADIUS
from moireaug.engine.lower.exposure_records import Camera
from moireaug.engine.lower.jacobian import panel_jacobian
from moireaug.geometry.distortion import NEWTON_STEPS
from moireaug.geometry.grids import NEAR_HORIZON
from moireaug.scene.lens import MIN_LENS_SLOPE

Arrays = tuple[np.ndarray, ...]


def cameras_of(cameras: np.ndarray) -> Any:
    """Return the fields (B, fields) of a batch's cameras as one Camera of arrays (B, 1, 1), which
    broadcast over points."""
    return Camera(*cameras.T[:, :, None, None])


def jacobian(u: np.ndarray, v: np.ndarray, c: Any) -> Arrays:
    """Return `panel_jacobian`, (B, h, w) each, at photo points about the centre; of rectified
    cameras, at where the photos show image points.

    c: from `cameras_of`.
    """
    if c.rectified.any():
        u, v = to_photo(u, v, c)
    return panel_jacobian(u, v, c)


def to_photo(x: np.ndarray, y: np.ndarray, c: Any) -> Arrays:
    """Return where image points lie on the photos, both about the centre, (B, h, w) each."""
    m = forward(c)
    entries = m.reshape(-1, 9).T[:, :, None, None]
    depth = entries[6] * x + entries[7] * y + entries[8]
    nearness = 1 / np.maximum(depth, NEAR_HORIZON)
    u = (entries[0] * x + entries[1] * y + entries[2]) * nearness
    v = (entries[3] * x + entries[4] * y + entries[5]) * nearness
    if not (c.k1.any() or c.k2.any()):
        return u, v
    ideal = np.sqrt((u * u + v * v) * c.bend)
    factor = np.where(ideal > 1e-9, undistorted(ideal, c.k1, c.k2) / np.maximum(ideal, 1e-9), 1)
    return u * factor, v * factor


def forward(c: Any) -> np.ndarray:
    """Return the homographies from image to ideal photo coordinates, (B, 3, 3)."""
    return np.linalg.inv(np.stack(c[:9], -1).reshape(-1, 3, 3))


def undistorted(ideal: np.ndarray, k1: np.ndarray, k2: np.ndarray) -> np.ndarray:
    """Return the radii that lenses take to ideal ones, by Newton steps."""
    inflection = -0.3 * k1 / np.where(k2 == 0, 1, k2)
    bends = (k2 != 0) & (inflection > 0) & (inflection < 1)
    r = np.where(bends, np.sqrt(np.where(bends, inflection, 1)), np.minimum(ideal, 1))
    for _ in range(NEWTON_STEPS):
        r2 = r * r
        error = r * (1 + r2 * (k1 + k2 * r2)) - ideal
        slope = np.maximum(1 + r2 * (3 * k1 + 5 * k2 * r2), MIN_LENS_SLOPE)
        r = np.clip(r - error / slope, 0, MAX_LENS_RADIUS)
    return r
