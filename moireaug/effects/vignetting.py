"""Natural vignetting: light falls off with the fourth power of the cosine of a ray's angle."""

from __future__ import annotations

from torch import Tensor

from moireaug.effects.base import Effect, Verdict, judged, show
from moireaug.effects.readings import over_sensor
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord


class Vignetting(Effect):
    """Loses light towards the photo's corners."""

    name = "vignetting"

    def verdict(self, scene: SceneRecord) -> Verdict:
        lost = bounds(scene.lens.vignetting)[1]
        why = f"{show(scene.lens.vignetting)} of the light lost in the corners"
        return judged(
            bounds(scene.sensor.gain)[1] * lost, scene, why, "no light lost in the corners"
        )

    def __call__(self, raw: Tensor, shot) -> Tensor:
        rows, cols = (pixels.positions(raw.device) for pixels in shot.sampled_pixels())
        return over_sensor(raw, falloff(rows, cols, shot.size, shot.lens.vignetting), shot)


def falloff(rows: Tensor, cols: Tensor, size: tuple[int, int], loss: Tensor) -> Tensor:
    """Return the share of light that is left, (B, h, w): 1 in the photo's centre and 1 - `loss`
    (B,) in its corners. The loss lies in [0, 1).

    Args:
        rows, cols: (h,) and (w,) photo coordinates. size: height and width of the photo.
    """
    h, w = size
    r2 = ((rows - h / 2).square()[:, None] + (cols - w / 2).square()[None, :]) * (
        4 / (h * h + w * w)
    )
    steep = ((1 - loss) ** -0.5 - 1)[:, None, None]  # the squared tangent of the corner's ray
    return (1 + steep * r2) ** -2
