"""Flicker: a panel dimmed by pulse-width modulation, seen through a rolling shutter."""

from __future__ import annotations

import torch
from torch import Tensor

from moireaug.effects.base import Effect, Verdict, judged, show
from moireaug.effects.readings import over_sensor
from moireaug.scene.fields import bounds
from moireaug.scene.record import SceneRecord


class Flicker(Effect):
    """Rows expose at different times of the panel's pulses."""

    name = "flicker"

    def verdict(self, scene: SceneRecord) -> Verdict:
        panel, sensor = scene.panel, scene.sensor
        why = f"pulses of {show(panel.pwm)} Hz, {show(panel.duty)} on, through a shutter of "
        why += f"{show(sensor.shutter)} s, rows read in {show(sensor.readout)} s"
        return judged(
            bounds(sensor.gain)[1] * depth(scene), scene, why, "no pulses, or no shutter given"
        )

    def __call__(self, raw: Tensor, shot) -> Tensor:
        panel, sensor = shot.panel, shot.sensor
        rows = shot.sampled_pixels()[0].positions(raw.device) / shot.size[0]
        bands = flicker(rows, panel.pwm, panel.duty, panel.phase, sensor.shutter, sensor.readout)
        return over_sensor(raw, bands[:, :, None], shot)


def depth(scene: SceneRecord) -> float:
    """Return the most by which a row's light can leave its mean, as a share of it."""
    panel, (short, long) = scene.panel, bounds(scene.sensor.shutter)
    (slow, fast), duty = bounds(panel.pwm), bounds(panel.duty)[0]
    if not fast or not long or duty == 1:
        return 0.0
    cycles = slow * short  # of the shortest exposure, at least
    brighter = (1 - duty) / max(duty, cycles)
    darker = 1.0 if cycles <= 1 - duty else (1 - duty) / cycles
    return max(brighter, darker)


def flicker(
    rows: Tensor, frequency: Tensor, duty: Tensor, phase: Tensor, shutter: Tensor, readout: Tensor
) -> Tensor:
    """Return how much light each row of the sensor gets of the panel's mean: (B, h), 1 on average.

    The panel is on for a share `duty` of each cycle, as bright as keeps its mean. Row r begins to
    expose at `r * readout` and does so for `shutter` seconds; the light of that time is a closed
    form. The bands have `frequency * readout` cycles from the first row to the last, and vanish
    where `shutter * frequency` is whole.

    Args:
        rows: (h,) or (B, h), 0 at the upper edge of the sensor and 1 at the lower one.
        frequency: (B,) hertz; 0 is a steady panel. duty: (B,) in (0, 1]. phase: (B,) cycles.
        shutter, readout: (B,) seconds, the first above 0.

    Differentiable in all of them, but for the corners where a pulse begins or ends.
    """
    drawn = (frequency, duty, phase, shutter, readout)
    frequency, duty, phase, shutter, readout = (t[:, None] for t in drawn)
    begin = phase + frequency * readout * rows
    cycles = frequency * shutter

    def lit(t: Tensor) -> Tensor:  # cycles of light from 0 to t
        whole = t.floor().detach()
        return whole * duty + torch.minimum(t - whole, duty)

    still = cycles < 1e-9
    share = (lit(begin + cycles) - lit(begin)) / (duty * torch.where(still, 1.0, cycles))
    return torch.where(still, torch.ones_like(share), share)
