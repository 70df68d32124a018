"""Natural vignetting: light falls off with the fourth power of the cosine of a ray's angle."""

from __future__ import annotations

from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, format_range, verdict_of
from moireaug.camera.effects.readings import in_planes, photo_coordinates, photo_size
from moireaug.common.tensor_physics import sensor
from moireaug.scene.fields import bounds
from moireaug.scene.geometry.frame import FrameSize
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


class Vignetting(Effect):
    """Loses light towards the photo's corners."""

    name = "vignetting"

    def verdict(self, scene: SceneRecord) -> Verdict:
        lost = bounds(scene.lens.vignetting)[1]
        why = f"{format_range(scene.lens.vignetting)} of the light lost in the corners"
        return verdict_of(
            bounds(scene.sensor.gain)[1] * lost, scene, why, "no light lost in the corners"
        )

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        u, v = photo_coordinates(shot)
        return raw * in_planes(falloff(u, v, photo_size(shot), shot.lens.vignetting), raw, shot)


def falloff(u: Tensor, v: Tensor, size: FrameSize, loss: Tensor) -> Tensor:
    """Return the share of light that is left, (B, h, w): 1 in the photo's centre and 1 - `loss`
    (B,) in its corners. The loss lies in [0, 1).

    Args:
        u, v: photo coordinates that broadcast to (h, w) or (B, h, w). size: height and width of the
            photo, numbers or (B, 1, 1).
    """
    h, w = size
    r2 = ((u - w / 2).square() + (v - h / 2).square()) * (4 / (h * h + w * w))
    steep = ((1 - loss) ** -0.5 - 1)[:, None, None]  # the squared tangent of the corner's ray
    return sensor.attenuation(1.0, steep, r2)
