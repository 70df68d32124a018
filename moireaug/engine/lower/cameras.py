"""The fields of a batch's cameras."""

from __future__ import annotations

import numpy as np

from moireaug.engine.lower.exposure_records import Camera
from moireaug.engine.lower.numbers import distortion_of
from moireaug.shot import ShotRecord

HOMOGRAPHY_FIELDS = [f"h{row}{column}" for row in range(3) for column in range(3)]


def camera_fields(shot: ShotRecord, drawn: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the fields of the cameras that `lower_cameras` takes."""
    plan, zero = shot.plan, np.zeros(len(shot))
    k1, k2 = distortion_of(shot, drawn)
    noisy = "noise" in plan
    return {
        "k1": k1,
        "k2": k2,
        "fill": drawn["sensor.fill"],
        "blur": drawn["lens.blur"],
        "olpf": drawn["lens.olpf"],
        "gain": drawn["sensor.gain"] if "gain" in plan else zero + 1,
        "read": drawn["sensor.read_noise"] if noisy else zero,
        "shot": drawn["sensor.shot_noise"] if noisy else zero,
        "vignetting": drawn["lens.vignetting"] if "vignetting" in plan else zero,
        "motion_x": drawn["lens.motion_x"],
        "motion_y": drawn["lens.motion_y"],
        "glare": drawn["panel.glare"] if "glare" in plan else zero,
        "glare_x": drawn["panel.glare_x"],
        "glare_y": drawn["panel.glare_y"],
        "rectified": zero,
    }


def lower_cameras(
    inverse: np.ndarray,
    size: tuple[int, int],
    scales: tuple[float | np.ndarray, float | np.ndarray],
    fields: dict[str, np.ndarray],
) -> np.ndarray:
    """Return the fields of one Camera per image, (B, fields).

    Args:
        inverse: (B, 3, 3), homography from ideal photo coordinates about the centre to image
            coordinates.
        size: height and width of photo and image. scales: sensor pixels per photo pixel, along rows
            and columns, one number or (B,) each.
        fields: (B,) each: k1, k2, alpha, fill, blur, olpf, gain, read, shot, vignetting, motion_x,
            motion_y, glare, glare_x, glare_y and rectified; neutral values for effects that are not
            planned.
    """
    h, w = size
    homography = dict(zip(HOMOGRAPHY_FIELDS, inverse.reshape(-1, 9).T, strict=True))
    derived = {
        "bend": 4 / (h * h + w * w),
        "scale_u": scales[1],
        "scale_v": scales[0],
        "dark_noise": fields["read"],
        "photon_noise": fields["shot"],
        "falloff": (1 - fields["vignetting"]) ** -0.5 - 1,
        "glare_u": fields["glare"] * fields["glare_x"] * 2 / w,
        "glare_v": fields["glare"] * fields["glare_y"] * 2 / h,
    }
    columns = fields | homography | derived
    cameras = np.empty((len(inverse), len(Camera._fields)))
    for i, name in enumerate(Camera._fields):
        cameras[:, i] = columns[name]
    return cameras
