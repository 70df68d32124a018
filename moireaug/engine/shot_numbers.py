"""A shot's drawn numbers for the kernels' records, in numpy."""

from __future__ import annotations

import numpy as np
import torch

from moireaug.engine import pose
from moireaug.scene.shot import ShotRecord

KEPT = 64  # scenes and sizes whose tables are cached


def numbers_of(shot: ShotRecord) -> dict[str, np.ndarray]:
    """Return the drawn numbers by name, "view.yaw", (B,) float64 each."""
    numbers = shot.numbers()
    rows = torch.stack(list(numbers.values())).detach().numpy()
    return dict(zip(numbers, rows, strict=True))


def distortion_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return k1 and k2, (B,) each; zeros without a lens."""
    if "lens" not in shot.plan:
        return np.zeros(len(shot)), np.zeros(len(shot))
    return drawn["lens.k1"], drawn["lens.k2"]


def homography_of(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> np.ndarray:
    """Return the homography from image to ideal photo coordinates, about the centres, (B, 3, 3)
    float64."""
    if shot.scene.view.pose != "camera":
        return pose.centred(shot.matrix().detach().numpy(), shot.size)
    return pose.camera_pose(drawn, shot.size, shot.scene.view.fit)
