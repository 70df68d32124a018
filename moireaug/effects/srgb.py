"""sRGB codes to light, and light to codes."""

from __future__ import annotations

from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from torch import Tensor

from moireaug.effects.base import Effect, Verdict, called, left_out
from moireaug.numeric import clip
from moireaug.scene.record import SizedScene
from moireaug.shot import ShotRecord

SLOPE_AT_BLACK = 12.92  # codes per light: the slope of sRGB at black


def in_codes(light: float, scene: SizedScene) -> float:
    """Return the most by which a change of light can change a code: sRGB is steepest at black."""
    return light * SLOPE_AT_BLACK if scene.develop.linear_light else light


class Decode(Effect):
    """Turns the panel's codes into light."""

    name = "decode"

    def verdict(self, scene: SizedScene) -> Verdict:
        if scene.develop.linear_light:
            return called("sRGB codes to light")
        return left_out("linear_light is off")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return rgb_to_linear_rgb(light)


class Encode(Effect):
    """Turns light into the camera's codes; the straight part of the curve continues below 0."""

    name = "encode"

    def verdict(self, scene: SizedScene) -> Verdict:
        if scene.develop.linear_light:
            return called("light to sRGB codes")
        return left_out("linear_light is off")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return linear_rgb_to_rgb(light)


class Clip(Effect):
    """Clips codes to [0, 1], whatever noise an attacker adds."""

    name = "clip"
    is_listed = False

    def verdict(self, scene: SizedScene) -> Verdict:
        return called("codes end at 0 and 1")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return clip(light)
