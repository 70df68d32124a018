"""Homographies about corners, in numpy."""

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
