"""The light that a display adds to its picture: of black pixels, and of the room in its glass."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, format_range, verdict_of
from moireaug.camera.effects.readings import in_planes, photo_coordinates, photo_size
from moireaug.camera.effects.srgb import in_codes
from moireaug.camera.exposure.extreme_light import max_glare
from moireaug.camera.exposure.filters import filters_of
from moireaug.camera.panel.fourier import mean_light_of
from moireaug.common.numeric import per_image
from moireaug.scene.drawn_parts import DrawnPanel
from moireaug.scene.fields import bounds
from moireaug.scene.geometry.frame import FrameSize
from moireaug.scene.geometry.lattice import CFA
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import ShotGeometry


class BlackLevel(Effect):
    """Black pixels of the display emit some light."""

    name = "black_level"

    def verdict(self, scene: SceneRecord) -> Verdict:
        black = scene.panel.black
        why = f"black pixels emit {format_range(black)} of a white one's light"
        change = bounds(black)[1] * bounds(scene.sensor.gain)[1]
        return verdict_of(in_codes(change, scene), scene, why, "black is black")

    def __call__(self, light: Tensor, shot: ShotRecord) -> Tensor:
        return light + per_image(shot.panel.black, light) * (1 - light)


class Glare(Effect):
    """The glass reflects the room: light without subpixels on top of the readings."""

    name = "glare"

    def verdict(self, scene: SceneRecord) -> Verdict:
        glare = scene.panel.glare
        why = f"the glass reflects {format_range(glare)} of a white screen's light"
        change = max_glare(scene) * bounds(scene.sensor.gain)[1]
        return verdict_of(in_codes(change, scene), scene, why, "the glass reflects nothing")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        share = glare_share(*photo_coordinates(shot), photo_size(shot), shot.panel)
        white = white_readings(shot).to(raw.dtype)[..., None, None]
        return raw + in_planes(share, raw, shot) * white


def glare_share(u: Tensor, v: Tensor, size: FrameSize, panel: DrawnPanel) -> Tensor:
    """Return the light that a panel's glass reflects, as a share of a white screen's: (B, h,
    w) at photo coordinates that broadcast to (h, w) or (B, h, w)."""
    right = u / size[1] * 2 - 1
    down = v / size[0] * 2 - 1
    across = panel.glare_x[:, None, None] * right
    along = panel.glare_y[:, None, None] * down
    return panel.glare[:, None, None] * (1 + across + along)


def white_readings(shot: ShotGeometry) -> Any:
    """Return the mean reading of a white screen in each plane, (B, planes) float64."""
    light = (filters_of(shot) @ mean_light_of(shot)[..., None])[..., 0]
    channels: list[int] = []
    for site in CFA[shot.scene.filter_cell]:
        channels.extend(site.channels)
    return light[:, channels]
