"""Flicker: a panel dimmed by pulse-width modulation, seen through a rolling shutter."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.camera.effects.base import Effect, Verdict, format_range, verdict_of
from moireaug.camera.effects.readings import in_planes, photo_coordinates
from moireaug.camera.exposure.extreme_light import modulation_depth
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord
from moireaug.scene.shot import ShotRecord

ROWS_OF_A_BIN = 8  # rows sampled within a bin


class Flicker(Effect):
    """Exposes each row at a different time of the panel's pulses."""

    name = "flicker"

    def verdict(self, scene: SceneRecord) -> Verdict:
        panel, sensor = scene.panel, scene.sensor
        why = f"pulses of {format_range(panel.pwm)} Hz, {format_range(panel.duty)} on, through a "
        why += f"shutter of {format_range(sensor.shutter)} s, rows read in "
        why += f"{format_range(sensor.readout)} s"
        return verdict_of(
            bounds(sensor.gain)[1] * modulation_depth(scene),
            scene,
            why,
            "no pulses, or no shutter given",
        )

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
