"""sRGB codes to light, and light to codes."""

from __future__ import annotations

from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, called, left_out
from moireaug.common.numeric import clip
from moireaug.common.physics.srgb import SLOPE_AT_BLACK
from moireaug.common.tensor_physics import srgb
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord


def in_codes(light: float, scene: SceneRecord) -> float:
    """Return the most by which a change of light can change a code: sRGB is steepest at black."""
    return light * SLOPE_AT_BLACK if scene.develop.linear_light else light


def light_of_codes(codes: Tensor) -> Tensor:
    """Return the light of sRGB codes of any shape: straight at and below black, and continued above
    white. Differentiable."""
    return srgb.light_of_code(codes)


def codes_of_light(light: Tensor) -> Tensor:
    """Return the sRGB codes of light of any shape, the inverse of `light_of_codes`."""
    return srgb.code_of_light(light)


class Decode(Effect):
    """Turns the panel's codes into light."""

    name = "decode"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if scene.develop.linear_light:
            return called("sRGB codes to light")
        return left_out("linear_light is off")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return light_of_codes(light)


class Encode(Effect):
    """Turns light into the camera's codes; the straight part of the curve continues below 0."""

    name = "encode"

    def verdict(self, scene: SceneRecord) -> Verdict:
        if scene.develop.linear_light:
            return called("light to sRGB codes")
        return left_out("linear_light is off")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return codes_of_light(light)


class Clip(Effect):
    """Clips codes to [0, 1], whatever noise an attacker adds."""

    name = "clip"
    is_listed = False

    def verdict(self, scene: SceneRecord) -> Verdict:
        return called("codes end at 0 and 1")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return clip(light)
