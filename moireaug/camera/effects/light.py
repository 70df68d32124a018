"""Light besides the picture's, and what is not the same all over the sensor: the display's black
level, flicker (pulse-width modulation, seen through a rolling shutter), glare, and vignetting."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, format_range, verdict_of
from moireaug.camera.effects.srgb import in_codes
from moireaug.camera.exposure.bin_geometry import pixels_on_photo
from moireaug.camera.exposure.extremes import max_glare, modulation_depth
from moireaug.camera.exposure.filters import filters_of
from moireaug.camera.panel import mean_light_of
from moireaug.common.numeric import per_image
from moireaug.common.tensor_physics import sensor
from moireaug.scene.drawn_parts import DrawnPanel
from moireaug.scene.fields import bounds
from moireaug.scene.geometry.frame import FrameSize, per_pixel
from moireaug.scene.geometry.lattice import CFA, pack
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord
from moireaug.scene.shot_geometry import ShotGeometry

ROWS_OF_A_BIN = 8  # rows sampled within a bin


def photo_coordinates(shot: ShotRecord) -> tuple[Tensor, Tensor]:
    """Return the coordinates u and v of the sensor's pixels on the whole photo, (1, w) and (h, 1),
    or of parts of photos (B, 1, w) and (B, h, 1); of a binned reading in the image's frame, (B, h,
    w) each."""
    if shot.scene.is_rectified:
        u, v = pixels_on_photo(shot)[0].unbind(-1)
        return u, v
    rows, cols = (pixels.positions(shot.device) for pixels in shot.sampled_pixels())
    frame = shot.frame
    return cols + per_pixel(frame.photo_left), rows[:, None] + per_pixel(frame.photo_top)


def photo_size(shot: ShotRecord) -> FrameSize:
    """Return height and width of the whole photo, as numbers or (B, 1, 1)."""
    height, width = shot.frame.size
    return per_pixel(height), per_pixel(width)


def in_planes(values: Tensor, raw: Tensor, shot: ShotRecord) -> Tensor:
    """Return values (B, h or 1, w or 1) that differ over the sensor, for the planes of a raw
    reading: (B, 4 or 1, ...), of its dtype."""
    rows, cols = (len(pixels.index) for pixels in shot.sampled_pixels())
    values = values.to(raw.dtype).expand(-1, rows, cols)
    return pack(values) if shot.scene.filter_cell == "rggb" else values[:, None]


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


class Flicker(Effect):
    """Exposes each row at a different time of the panel's pulses."""

    name = "flicker"

    def verdict(self, scene: SceneRecord) -> Verdict:
        panel, sensor = scene.panel, scene.sensor
        why = f"pulses of {format_range(panel.pwm)} Hz, {format_range(panel.duty)} on, through a "
        why += f"shutter of {format_range(sensor.shutter)} s, rows read in "
        why += f"{format_range(sensor.readout)} s"
        change = bounds(sensor.gain)[1] * modulation_depth(scene)
        return verdict_of(change, scene, why, "no pulses, or no shutter given")

    def __call__(self, raw: Tensor, shot: ShotRecord) -> Tensor:
        _, v = photo_coordinates(shot)
        light = light_of_rows(v.flatten(-2), shot).unflatten(1, v.shape[-2:])
        return raw * in_planes(light, raw, shot)


def light_of_rows(rows: Tensor, shot: ShotRecord) -> Tensor:
    """Return the light at photo coordinates (n,) or (B, n) along the sensor's columns relative to
    the panel's mean, (B, n) float64; of a binned reading, the mean of a bin's rows there."""
    panel, sensor = shot.panel, shot.sensor
    pulses = panel.pwm, panel.duty, panel.phase
    height = shot.frame.height
    height = height[:, None] if isinstance(height, Tensor) else height
    if not shot.scene.is_binned:
        return flicker(rows / height, *pulses, sensor.shutter, sensor.readout)
    parts = torch.arange(ROWS_OF_A_BIN, dtype=rows.dtype, device=rows.device) + 0.5
    wide = (shot.bin_scale / shot.sensor_scale)[:, None, None]
    rows = rows[..., None] + wide * (parts / ROWS_OF_A_BIN - 0.5)
    bands = flicker(rows.flatten(1) / height, *pulses, sensor.shutter, sensor.readout)
    return bands.unflatten(1, (-1, ROWS_OF_A_BIN)).mean(2)


def flicker(
    rows: Tensor, frequency: Tensor, duty: Tensor, phase: Tensor, shutter: Tensor, readout: Tensor
) -> Tensor:
    """Return each sensor row's light relative to the panel's mean: (B, h), 1 on average.

    The panel is on for a share `duty` of each cycle, bright enough to keep its mean. Row r begins
    to expose at `r * readout` seconds and exposes for `shutter` seconds; the light in that time has
    a closed form. The bands have `frequency * readout` cycles from the first row to the last,
    and vanish where `shutter * frequency` is whole.

    Args:
        rows: (h,) or (B, h), 0 at the upper edge of the sensor and 1 at the lower one.
        frequency: (B,) hertz; 0 is a steady panel. duty: (B,) in (0, 1]. phase: (B,) cycles.
        shutter, readout: (B,) seconds; a shutter of 0 hides the flicker.

    Differentiable in all of them, except where a row's exposure begins or ends with a pulse.
    """
    drawn = (frequency, duty, phase, shutter, readout)
    frequency, duty, phase, shutter, readout = (t[:, None] for t in drawn)
    begin = phase + frequency * readout * rows
    cycles = frequency * shutter

    def lit(t: Tensor) -> Tensor:  # cycles of light from 0 to t
        whole = t.floor().detach()
        return whole * duty + torch.minimum(t - whole, duty)

    is_steady = cycles < 1e-9
    share = (lit(begin + cycles) - lit(begin)) / (duty * torch.where(is_steady, 1.0, cycles))
    return torch.where(is_steady, torch.ones_like(share), share)


class Vignetting(Effect):
    """Loses light towards the photo's corners."""

    name = "vignetting"

    def verdict(self, scene: SceneRecord) -> Verdict:
        change = bounds(scene.sensor.gain)[1] * bounds(scene.lens.vignetting)[1]
        why = f"{format_range(scene.lens.vignetting)} of the light lost in the corners"
        return verdict_of(change, scene, why, "no light lost in the corners")

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
    return sensor.attenuation(1.0, corner_steepness(loss)[:, None, None], r2)


def corner_steepness(loss: Any) -> Any:
    """Return the squared tangent of the angle of a ray to the photo's corners, where the share
    `loss` (B,) of light is lost; of torch or numpy."""
    return (1 - loss) ** -0.5 - 1
