"""The homography of `moireaug.geometry.homography`, about the centres of image and photo, in numpy,
which is several times as fast as torch for so few numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from moireaug.geometry.homography import BEHIND_CAMERA, BORDER, LEAST_DEPTH


def camera_pose(
    drawn: Mapping[str, np.ndarray], size: tuple[int, int], fit: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the homography from image coordinates to ideal photo coordinates, both about the
    centre, (B, 3, 3), and `homography.magnification`, (B,).

    Args:
        drawn: a shot's (B,) numbers by name. size: height and width. fit: see `View`.
    """
    h, w = size
    yaw, pitch, roll = (np.deg2rad(drawn[name]) for name in ("view.yaw", "view.pitch", "view.roll"))
    sy, cy = np.sin(yaw), np.cos(yaw)
    sp, cp = np.sin(pitch), np.cos(pitch)
    sr, cr = np.sin(roll), np.cos(roll)
    f = math.hypot(h, w) / 2 / np.tan(np.deg2rad(drawn["view.fov"]) / 2)
    out = np.zeros((len(yaw), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = cy * cr, cy * sr
    out[:, 1, 0], out[:, 1, 1] = sp * sy * cr - cp * sr, sp * sy * sr + cp * cr
    out[:, 2, 0], out[:, 2, 1] = (cp * sy * cr + sp * sr) / f, (cp * sy * sr - sp * cr) / f
    out[:, 2, 2] = 1
    zoom = drawn["view.zoom"]
    if fit:
        zoom = zoom * _fitting_zoom(out, drawn["lens.k1"], drawn["lens.k2"], size)
    out[:, :2] *= zoom[:, None, None]
    out[:, 0] += (drawn["view.shift_x"] * w)[:, None] * out[:, 2]
    out[:, 1] += (drawn["view.shift_y"] * h)[:, None] * out[:, 2]
    return out, zoom


def _fitting_zoom(
    m: np.ndarray, k1: np.ndarray, k2: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Return the greatest magnification at which the picture's border still lies inside the photo,
    (B,)."""
    h, w = size
    half = np.array([w / 2, h / 2])
    points = np.array(BORDER) * half
    depth = points @ m[:, 2, :2].T + 1  # (16, B)
    ahead = depth > LEAST_DEPTH
    depth = np.where(ahead, depth, 1)
    x = np.where(ahead, points @ m[:, 0, :2].T / depth, BEHIND_CAMERA)
    y = np.where(ahead, points @ m[:, 1, :2].T / depth, BEHIND_CAMERA)
    to_edge = 1 / np.maximum(np.abs(x) / half[0], np.abs(y) / half[1])
    r2 = (x * x + y * y) * to_edge * to_edge * (4 / (h * h + w * w))
    return (to_edge * (1 + r2 * (k1 + k2 * r2))).min(0)


def from_corner(m: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return homographies (B, 3, 3) to image coordinates about the centre as those to image
    coordinates."""
    (h, w), out = size, m.copy()
    out[:, 0] += w / 2 * out[:, 2]
    out[:, 1] += h / 2 * out[:, 2]
    return out


def centred(m: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a homography from image to ideal photo coordinates, (B, 3, 3), about the centres of
    both."""
    h, w = size
    there = np.array([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    back = np.array([[1, 0, -w / 2], [0, 1, -h / 2], [0, 0, 1]])
    return back @ m @ there
