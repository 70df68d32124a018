"""Registration: the photo in the frame of the image that was shown."""

from __future__ import annotations

from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, left_out
from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.common.numeric import clip_straight_through
from moireaug.scene.fields import bounds, varies
from moireaug.scene.geometry.grids import look_up
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class Register(Effect):
    """Warps the photo back to the image's frame, so that labels, boxes and masks stay valid. Binned
    readings lie there already; parts of the image that the photo does not show are blackened."""

    name = "register"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if not scene.develop.registered:
            return left_out("the photo stays in the camera's frame")
        if not (scene.is_posed or scene.is_bent):
            return left_out("the photo is in the image's frame already")
        if scene.is_crop:
            return left_out("a crop lies within its photo; bins are read in the image's frame")
        if not scene.is_rectified:
            return called("back to the image's frame")
        if _is_shown_whole(scene):
            return left_out("bins are read in the image's frame")
        return called("black where the photo does not show the image; bins are read in its frame")

    def __call__(self, photo: Tensor, shot: ShotRecord) -> Tensor:
        points, on_photo = pixels_on_photo(shot)
        if not shot.scene.is_rectified:
            photo = clip_straight_through(look_up(photo, *points.unbind(-1)))
        return photo * on_photo.to(photo.dtype)[:, None]


def _is_shown_whole(scene: SceneRecord) -> bool:
    """Whether the photo always shows all of the image: one that fits, is not enlarged and not
    moved."""
    view = scene.view
    shifted = varies(view.shift_x) or varies(view.shift_y)
    return view.fit and bounds(view.zoom)[1] <= 1 and not shifted
