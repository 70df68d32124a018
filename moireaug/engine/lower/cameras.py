"""The fields of a batch's cameras, and their homographies."""

from __future__ import annotations

from typing import Any

import numpy as np

from moireaug.engine.lower.exposure_records import Camera
from moireaug.scene.shot_geometry import HostGeometry

HOMOGRAPHY_FIELDS = [f"h{row}{column}" for row in range(3) for column in range(3)]


def camera_fields(geometry: HostGeometry) -> dict[str, np.ndarray]:
    """Return the fields of a shot's cameras that neither pose nor scale change; neutral values for
    effects that are not planned."""
    drawn, (h, w), (k1, k2) = geometry.numbers(), geometry.photo_size, geometry.lens_distortion
    zero = np.zeros_like(k1)

    def planned(effect: str, name: str, neutral: np.ndarray = zero) -> np.ndarray:
        return drawn[name] if effect in geometry.plan else neutral

    vignetting = planned("vignetting", "lens.vignetting")
    glare = planned("glare", "panel.glare")
    return {
        "k1": k1,
        "k2": k2,
        "radius_scale": zero + 4 / (h * h + w * w),
        "fill": drawn["sensor.fill"],
        "blur": drawn["lens.blur"],
        "olpf": drawn["lens.olpf"],
        "gain": planned("gain", "sensor.gain", zero + 1),
        "dark_noise": planned("noise", "sensor.read_noise"),
        "photon_noise": planned("noise", "sensor.shot_noise"),
        "falloff": (1 - vignetting) ** -0.5 - 1,
        "motion_x": drawn["lens.motion_x"],
        "motion_y": drawn["lens.motion_y"],
        "glare": glare,
        "glare_u": glare * drawn["panel.glare_x"] * 2 / w,
        "glare_v": glare * drawn["panel.glare_y"] * 2 / h,
        "rectified": zero,
        "photo_height": zero + h,
        "photo_width": zero + w,
        "centre_u": zero,
        "centre_v": zero,
        "lead_x": zero,
        "lead_y": zero,
        "corner_x": zero + w / 2,
        "corner_y": zero + h / 2,
        "pulses_top": zero - h / 2,
        "pulses_height": zero + h,
    }


def lower_cameras(
    inverse: np.ndarray,
    scales: tuple[float | np.ndarray, float | np.ndarray],
    fields: dict[str, np.ndarray],
) -> np.ndarray:
    """Return the fields of one Camera per image, (B, fields).

    Args:
        inverse: (B, 3, 3), homography from ideal photo coordinates about the centre to image
            coordinates.
        scales: sensor pixels per photo pixel, along rows and columns, one number or (B,) each.
        fields: (B,) each: `camera_fields` and alpha.
    """
    homography = dict(zip(HOMOGRAPHY_FIELDS, inverse.reshape(-1, 9).T, strict=True))
    columns = fields | homography | {"scale_u": scales[1], "scale_v": scales[0]}
    cameras = np.empty((len(inverse), len(Camera._fields)))
    for i, name in enumerate(Camera._fields):
        cameras[:, i] = columns[name]
    return cameras


def from_corner(m: np.ndarray, x: Any, y: Any) -> np.ndarray:
    """Move the origin of the image coordinates that homographies (B, 3, 3) lead to, from the
    centre to a corner x to its left and y above it, numbers or (B, 1) each."""
    out = m.copy()
    out[:, 0] += x * out[:, 2]
    out[:, 1] += y * out[:, 2]
    return out
