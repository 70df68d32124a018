"""Homographies about corners and centres, in numpy."""

from __future__ import annotations

from typing import Any

import numpy as np


def from_corner(m: np.ndarray, x: Any, y: Any) -> np.ndarray:
    """Move the origin of the image coordinates that homographies (B, 3, 3) lead to, from the
    centre to a corner x to its left and y above it, numbers or (B, 1) each."""
    out = m.copy()
    out[:, 0] += x * out[:, 2]
    out[:, 1] += y * out[:, 2]
    return out


def centred(m: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a homography from image to ideal photo coordinates, (B, 3, 3), about the centres of
    both."""
    h, w = size
    there = np.array([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    back = np.array([[1, 0, -w / 2], [0, 1, -h / 2], [0, 0, 1]])
    return back @ m @ there
