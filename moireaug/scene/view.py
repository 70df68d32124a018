"""The view: where the camera stands."""

from __future__ import annotations

from dataclasses import dataclass

from moireaug.common.argument_checks import one_of
from moireaug.scene.fields import Part, Range, bounds, ranged

POSES = ("camera", "released")


@dataclass(frozen=True, kw_only=True)
class View(Part):
    """Where the camera stands. All fields but `fit` and `pose` are ranges.

    The angles turn the screen about its centre: first `roll` in its plane, then `yaw`, then
    `pitch`.

    Args:
        yaw: degrees about the vertical axis; positive moves the right edge away from the camera.
        pitch: degrees about the horizontal axis; positive moves the upper edge away from the
            camera.
        roll: degrees in the image plane, counter-clockwise positive as seen in the photo.
        zoom: magnification of the picture in the photo; 1 is edge to edge when frontal.
        shift_x, shift_y: shift of the picture in the photo, as a fraction of the photo's width and
            height.
        fov: angle that the picture's diagonal spans as seen from the camera, in degrees: a small
            value is a distant camera. Not read for crops, which have `Sensor.focal`.
        fit: move the camera back until the whole picture is in the photo, before `zoom` and the
            shifts apply; behind a strong lens, its border may reach out by 0.3 % of a side. Not
            read for crops.
        pose: "camera" is a pinhole camera as described; "released" is the homography of the paper's
            released code: whole degrees, of a range all but the highest, and a focal length tied
            to the roll (`fov`, `zoom` and the shifts are not read).
    """

    yaw: Range = ranged(0.0, -89.0, 89.0, "degrees")
    pitch: Range = ranged(0.0, -89.0, 89.0, "degrees")
    roll: Range = ranged(0.0, -180.0, 180.0, "degrees")
    zoom: Range = ranged(1.0, 1e-3, 100.0)
    shift_x: Range = ranged(0.0, -1.0, 1.0)
    shift_y: Range = ranged(0.0, -1.0, 1.0)
    fov: Range = ranged(40.0, 1.0, 89.0, "degrees")
    fit: bool = True
    pose: str = "camera"

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("View.pose", self.pose, POSES)
        if self.pose == "released":
            for name in ("yaw", "pitch", "roll"):
                value = getattr(self, name)
                if not hasattr(value, "shape") and any(end % 1 for end in bounds(value)):
                    raise ValueError(
                        f"View.{name} must be in whole degrees where pose = 'released', which "
                        f"draws no others; got {value!r}. Round it, or use pose = 'camera'."
                    )
